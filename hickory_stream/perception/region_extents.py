"""The extent of regions in space: principal axes, boxes and heights, also of the union of two regions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.perception.region_graph import HEIGHT_BIN_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.region_graph import Regions

LEAST_M = 0.01
"""Lower bound of sizes, so that ratios of sizes are not dominated by noise."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Extents:
    """The extent of n regions in space; all arrays (n, ...).

    `axes_m` (n, 3): standard deviations along the principal axes, smallest first; `low_m`, `high_m`: 5th and 95th
    percentile of the heights; `box_low_m`, `box_high_m` (n, 3); `sigma_m`: mean standard deviation of depth. Derived:
    `width_m`, the horizontal diagonal of the box, and `height_m`, between the percentiles.
    """

    axes_m: NDArray[np.float64]
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]
    box_low_m: NDArray[np.float64]
    box_high_m: NDArray[np.float64]
    sigma_m: NDArray[np.float64]
    width_m: NDArray[np.float64] = field(init=False)
    height_m: NDArray[np.float64] = field(init=False)

    def __post_init__(self) -> None:
        sides = self.box_high_m - self.box_low_m
        width_m = np.maximum(portable.hypot(sides[:, 0], sides[:, 1]), LEAST_M)
        object.__setattr__(self, "width_m", width_m)
        object.__setattr__(self, "height_m", np.maximum(self.high_m - self.low_m, LEAST_M))


def extents_of(regions: Regions, bottom_m: float) -> Extents:
    """Return the extent of regions; heights count from `bottom_m`."""
    low_m, high_m = _heights(regions, bottom_m)
    return Extents(
        axes_m=_axes(regions.pixels, regions.place, regions.place_products),
        low_m=low_m,
        high_m=high_m,
        box_low_m=regions.low,
        box_high_m=regions.high,
        sigma_m=np.maximum(regions.sigma_m / np.maximum(regions.pixels, 1), 1e-4),
    )


def union_of(regions: Regions, extents: Extents, large: NDArray[np.int64], small: NDArray[np.int64]) -> Extents:
    """Return the extent of the union of the two regions of each pair."""
    return Extents(
        axes_m=_axes(
            regions.pixels[large] + regions.pixels[small],
            regions.place[large] + regions.place[small],
            regions.place_products[large] + regions.place_products[small],
        ),
        low_m=np.minimum(extents.low_m[large], extents.low_m[small]),
        high_m=np.maximum(extents.high_m[large], extents.high_m[small]),
        box_low_m=np.minimum(regions.low[large], regions.low[small]),
        box_high_m=np.maximum(regions.high[large], regions.high[small]),
        sigma_m=np.maximum(extents.sigma_m[large], extents.sigma_m[small]),
    )


def _heights(regions: Regions, bottom_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the 5th and 95th percentile of each region's heights."""
    below = np.cumsum(regions.heights, axis=1)
    low, high = ((below < share * regions.pixels[:, None]).sum(axis=1) for share in (0.05, 0.95))
    return bottom_m + (low + 0.5) * HEIGHT_BIN_M, bottom_m + (high + 0.5) * HEIGHT_BIN_M


def _axes(
    pixels: NDArray[np.float64], place: NDArray[np.float64], products: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (n, 3) the standard deviations of each region's points along its principal axes, the smallest first."""
    per = np.maximum(pixels, 1)[:, None]
    mean, second = place / per, products / per
    covariance = second[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3) - mean[:, :, None] * mean[:, None, :]
    return np.asarray(np.sqrt(np.maximum(portable.eigenvalues(covariance), 0)))
