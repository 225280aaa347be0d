"""Pairs of merged regions, large and small, with all measures that their features are computed from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.pair_geometry import pair_geometry
from hickory_stream.perception.region_extents import extents_of, union_of
from hickory_stream.perception.region_graph import merged_pairs, merged_regions
from hickory_stream.perception.support_contacts import support_contacts_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.pair_geometry import PairGeometry
    from hickory_stream.perception.region_extents import Extents
    from hickory_stream.perception.region_graph import RegionGraph, RegionPairs, Regions
    from hickory_stream.perception.support_contacts import SupportContacts


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OrderedPairs:
    """K pairs of merged regions, of which `large` (K,) has at least as many pixels as `small` (K,).

    `regions`, `extents` and `support` are measures by region; `pairs`, `geometry` and `union` (the extents of both
    regions together) by pair. `is_turned` (K,): `large` is the region b of `pairs`. `graph` is that of the fragments.
    """

    graph: RegionGraph
    regions: Regions
    extents: Extents
    support: SupportContacts
    pairs: RegionPairs
    large: NDArray[np.int64]
    small: NDArray[np.int64]
    is_turned: NDArray[np.bool_]
    geometry: PairGeometry
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
