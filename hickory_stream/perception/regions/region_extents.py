"""The extent of regions in space, and of the union of two: principal axes, boxes and heights."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import diagonalise
from hickory_stream.perception.regions.region_graph import HEIGHT_BIN_M, Regions

# Lower bound of sizes, so that noise does not dominate ratios of sizes.
LEAST_M = 0.01


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Extents:
    """The extent of n regions in space; all arrays (n, ...)."""

    #: (n, 3) standard deviations along the principal axes, smallest first
    axes_m: NDArray[np.float64]
    #: 5th percentile of the heights; `high_m`: the 95th
    low_m: NDArray[np.float64]
    high_m: NDArray[np.float64]
    box_low_m: NDArray[np.float64]
    box_high_m: NDArray[np.float64]
    #: mean standard deviation of depth
    sigma_m: NDArray[np.float64]
    #: horizontal diagonal of the box
    width_m: NDArray[np.float64]
    #: between the percentiles
    height_m: NDArray[np.float64]


def extents_of(regions: Regions, bottom_m: float) -> Extents:
    """Return the extent of regions; heights count from `bottom_m`."""
    # The first bins up to which a share of the heights lies.
    below, pixels = np.cumsum(regions.heights, axis=1), regions.pixels[:, None]
    low_m, high_m = (bottom_m + ((below < share * pixels).sum(axis=1) + 0.5) * HEIGHT_BIN_M for share in (0.05, 0.95))
    return _extents(
        _principal_axes(regions.pixels, regions.place, regions.place_products),
        (low_m, high_m),
        (regions.low, regions.high),
        np.maximum(regions.sigma_m / np.maximum(regions.pixels, 1.0), 1e-4),
    )


def union_of(regions: Regions, extents: Extents, large: NDArray[np.int64], small: NDArray[np.int64]) -> Extents:
    """Return the extent of the union of the two regions of each pair."""
    sums = (own[large] + own[small] for own in (regions.pixels, regions.place, regions.place_products))
    lows = (np.minimum(own[large], own[small]) for own in (extents.low_m, extents.box_low_m))
    highs = (np.maximum(own[large], own[small]) for own in (extents.high_m, extents.box_high_m))
    heights, box = zip(lows, highs, strict=True)
    return _extents(_principal_axes(*sums), heights, box, np.maximum(extents.sigma_m[large], extents.sigma_m[small]))


_Ends = tuple[NDArray[np.float64], NDArray[np.float64]]


def _extents(axes_m: NDArray[np.float64], heights_m: _Ends, box_m: _Ends, sigma_m: NDArray[np.float64]) -> Extents:
    (low_m, high_m), (box_low_m, box_high_m) = heights_m, box_m
    x, y, _ = (box_high_m - box_low_m).T
    return Extents(
        axes_m=axes_m,
        low_m=low_m,
        high_m=high_m,
        box_low_m=box_low_m,
        box_high_m=box_high_m,
        sigma_m=sigma_m,
        width_m=np.maximum(np.sqrt(x * x + y * y), LEAST_M),
        height_m=np.maximum(high_m - low_m, LEAST_M),
    )


# The entries of a symmetric matrix (3, 3) among xx xy xz yy yz zz.
_ENTRIES = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


def _principal_axes(
    pixels: NDArray[np.float64], place: NDArray[np.float64], products: NDArray[np.float64]
) -> NDArray[np.float64]:
    # `place` (n, 3) and `products` (n, 6) are sums over the points.
    per = np.maximum(pixels, 1.0)[:, None]
    mean = place / per
    covariances = (products / per)[:, _ENTRIES] - mean[:, :, None] * mean[:, None, :]
    _diagonalise_each(covariances, np.empty((3, 3)))
    return np.sqrt(np.maximum(covariances.diagonal(axis1=1, axis2=2), 0.0))


@kernel
def _diagonalise_each(matrices, vectors):
    for i in range(len(matrices)):
        diagonalise(matrices[i], vectors)
