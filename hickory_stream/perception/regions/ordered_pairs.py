"""Pairs of merged regions, large and small, with all measures for their features.

`pair_features` derives ratios, angles and multiples of sigma from these, `absolute_features` lengths.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.perception.regions.contacts import SupportContacts, support_contacts_of
from hickory_stream.perception.regions.region_extents import Extents, extents_of, union_of
from hickory_stream.perception.regions.region_graph import (
    RegionGraph,
    RegionPairs,
    Regions,
    merged_pairs,
    merged_regions,
)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairGeometry:
    """The regions `large` and `small` of K pairs; all arrays (K, 3), along the axes of the world."""

    #: vector from the centroid of the large region to the small one's
    aside_m: NDArray[np.float64]
    #: overlap of their boxes, negative for a gap
    overlap_m: NDArray[np.float64]
    #: distance of the small box to the nearer end of the large one, negative where it protrudes
    inset_m: NDArray[np.float64]
    #: mean of the contact pixels' positions, undefined without contact, like their spread
    contact_m: NDArray[np.float64]
    contact_spread_m: NDArray[np.float64]


def pair_geometry(
    regions: Regions, pairs: RegionPairs, large: NDArray[np.int64], small: NDArray[np.int64]
) -> PairGeometry:
    """Return the relative geometry of the regions `large` and `small` (K,) of K pairs."""
    middle_m, touch = regions.place / np.maximum(regions.pixels, 1.0)[:, None], np.maximum(pairs.touch, 1.0)[:, None]
    low, high, inner_low, inner_high = regions.low[large], regions.high[large], regions.low[small], regions.high[small]
    contact_m = pairs.contact / touch
    return PairGeometry(
        aside_m=middle_m[small] - middle_m[large],
        overlap_m=np.minimum(high, inner_high) - np.maximum(low, inner_low),
        inset_m=np.minimum(inner_low - low, high - inner_high),
        contact_m=contact_m,
        contact_spread_m=np.sqrt(np.maximum(pairs.contact_squares / touch - contact_m * contact_m, 0.0)),
    )


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OrderedPairs:
    """K pairs of merged regions: measures by region (`regions` to `support`) and by pair (`pairs` to `union`)."""

    #: the graph of the fragments
    graph: RegionGraph
    regions: Regions
    extents: Extents
    support: SupportContacts
    pairs: RegionPairs
    #: (K,) has at least as many pixels as `small`
    large: NDArray[np.int64]
    small: NDArray[np.int64]
    #: (K,) `large` is the region b of `pairs`
    is_turned: NDArray[np.bool_]
    geometry: PairGeometry
    #: extents of both regions together
    union: Extents


def ordered_pairs(graph: RegionGraph, numbers: NDArray[np.int64], count: int) -> OrderedPairs:
    """Return the pairs of merged regions; `numbers` (n,) gives the merged region 0..count - 1 of each fragment."""
    regions, pairs = merged_regions(graph.regions, numbers, count), merged_pairs(graph.pairs, numbers)
    is_turned = regions.pixels[pairs.a] < regions.pixels[pairs.b]
    large, small = np.where(is_turned, pairs.b, pairs.a), np.where(is_turned, pairs.a, pairs.b)
    extents = extents_of(regions, graph.bottom_m)
    return OrderedPairs(
        graph=graph,
        regions=regions,
        extents=extents,
        support=support_contacts_of(graph.contacts, np.append(numbers, count), graph.heights_m, graph.level),
        pairs=pairs,
        large=large,
        small=small,
        is_turned=is_turned,
        geometry=pair_geometry(regions, pairs, large, small),
        union=union_of(regions, extents, large, small),
    )
