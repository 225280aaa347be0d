"""Where the two parts of each pair lie to each other: their middles, their boxes and the seam between them, in metres.

What `affinity` tells as ratios, angles and multiples of sigma, and `sizes` as lengths, begins with these.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.parts import Pairs, Parts


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairGeometry:
    """The parts `large` and `small` of K pairs; all arrays (K, 3), along the axes of the world.

    `aside_m`: from the middle of the large part to that of the small one. Of their boxes, `overlap_m` is how far they
    overlap, negative where there is a gap, and `inset_m` how far the small one keeps off the nearer end of the large
    one, negative where it stands out. Of the seam, `seam_m` is the middle and `seam_spread_m` the standard deviation;
    neither means anything for parts that do not touch.
    """

    aside_m: NDArray[np.float64]
    overlap_m: NDArray[np.float64]
    inset_m: NDArray[np.float64]
    seam_m: NDArray[np.float64]
    seam_spread_m: NDArray[np.float64]


def pair_geometry(parts: Parts, pairs: Pairs, large: NDArray[np.int64], small: NDArray[np.int64]) -> PairGeometry:
    """Return how the parts `large` and `small` (K,) of K pairs lie to each other."""
    center = parts.place / np.maximum(parts.pixels, 1)[:, None]
    touch = np.maximum(pairs.touch, 1)[:, None]
    seam_m = pairs.seam / touch
    return PairGeometry(
        aside_m=center[small] - center[large],
        overlap_m=np.minimum(parts.high[large], parts.high[small]) - np.maximum(parts.low[large], parts.low[small]),
        inset_m=np.minimum(parts.low[small] - parts.low[large], parts.high[large] - parts.high[small]),
        seam_m=seam_m,
        seam_spread_m=np.sqrt(np.maximum(pairs.seam_squares / touch - seam_m * seam_m, 0)),
    )
