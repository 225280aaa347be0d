"""Relative geometry of the two regions of each pair: their centroids, boxes and contact, in metres.

`pair_features` derives ratios, angles and multiples of sigma from these, `absolute_features` lengths.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.region_graph import RegionPairs, Regions


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairGeometry:
    """The regions `large` and `small` of K pairs; all arrays (K, 3), along the axes of the world.

    `aside_m`: vector from the centroid of the large region to that of the small one. `overlap_m`: overlap of their
    boxes, negative for a gap. `inset_m`: distance of the small box to the nearer end of the large one, negative where
    it protrudes. `contact_m`, `contact_spread_m`: mean and standard deviation of the contact pixels' positions,
    undefined for regions that do not touch.
    """

    aside_m: NDArray[np.float64]
    overlap_m: NDArray[np.float64]
    inset_m: NDArray[np.float64]
    contact_m: NDArray[np.float64]
    contact_spread_m: NDArray[np.float64]


def pair_geometry(
    regions: Regions, pairs: RegionPairs, large: NDArray[np.int64], small: NDArray[np.int64]
) -> PairGeometry:
    """Return the relative geometry of the regions `large` and `small` (K,) of K pairs."""
    center = regions.place / np.maximum(regions.pixels, 1)[:, None]
    touch = np.maximum(pairs.touch, 1)[:, None]
    contact_m = pairs.contact / touch
    return PairGeometry(
        aside_m=center[small] - center[large],
        overlap_m=np.minimum(regions.high[large], regions.high[small])
        - np.maximum(regions.low[large], regions.low[small]),
        inset_m=np.minimum(regions.low[small] - regions.low[large], regions.high[large] - regions.high[small]),
        contact_m=contact_m,
        contact_spread_m=np.sqrt(np.maximum(pairs.contact_squares / touch - contact_m * contact_m, 0)),
    )
