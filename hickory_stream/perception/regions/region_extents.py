"""The extent of regions in space, and of the union of two: principal axes, boxes and heights."""

from __future__ import annotations

from dataclasses import dataclass, fields

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
    extents = _blank(len(regions.pixels))
    _fill_extents(
        (regions.pixels, regions.sigma_m, regions.place, regions.place_products, regions.heights),
        (regions.low, regions.high),
        bottom_m,
        _arrays(extents),
    )
    return extents


def union_of(regions: Regions, extents: Extents, large: NDArray[np.int64], small: NDArray[np.int64]) -> Extents:
    """Return the extent of the union of the two regions of each pair."""
    union = _blank(len(large))
    sums = regions.pixels, regions.place, regions.place_products
    _fill_unions(sums, _arrays(extents), large, small, _arrays(union))
    return union


def _blank(count: int) -> Extents:
    vectors = {name: np.empty((count, 3)) for name in ("axes_m", "box_low_m", "box_high_m")}
    return Extents(**{field.name: vectors.get(field.name, np.empty(count)) for field in fields(Extents)})


def _arrays(extents: Extents) -> tuple[NDArray[np.float64], ...]:
    return tuple(getattr(extents, field.name) for field in fields(Extents))


@kernel
def _fill_extents(sums, boxes, bottom_m, out):
    pixels, sigma_m, place, products, heights = sums
    (low, high), (axes, low_m, high_m, box_low, box_high, out_sigma_m, width_m, height_m) = boxes, out
    covariance, vectors = np.empty((3, 3)), np.empty((3, 3))
    for i in range(len(pixels)):
        _principal_axes(pixels[i], place[i], products[i], covariance, vectors, axes[i])
        # The first bins up to which a share of the heights lies.
        below, lowest, highest = 0.0, 0, 0
        for k in range(heights.shape[1]):
            below += heights[i, k]
            lowest += below < 0.05 * pixels[i]
            highest += below < 0.95 * pixels[i]
        low_m[i], high_m[i] = bottom_m + (lowest + 0.5) * HEIGHT_BIN_M, bottom_m + (highest + 0.5) * HEIGHT_BIN_M
        out_sigma_m[i] = max(sigma_m[i] / max(pixels[i], 1.0), 1e-4)
        for k in range(3):
            box_low[i, k], box_high[i, k] = low[i, k], high[i, k]
        width_m[i], height_m[i] = _sizes(box_low[i], box_high[i], low_m[i], high_m[i])


@kernel
def _fill_unions(sums, extents, larges, smalls, out):
    pixels, place, products = sums
    _, low_m, high_m, box_low_m, box_high_m, sigma_m, _, _ = extents
    axes, out_low_m, out_high_m, box_low, box_high, out_sigma_m, width_m, height_m = out
    covariance, vectors = np.empty((3, 3)), np.empty((3, 3))
    both, both_products = np.empty(3), np.empty(6)
    for i in range(len(larges)):
        large, small = larges[i], smalls[i]
        for k in range(3):
            both[k] = place[large, k] + place[small, k]
            box_low[i, k] = min(box_low_m[large, k], box_low_m[small, k])
            box_high[i, k] = max(box_high_m[large, k], box_high_m[small, k])
        for k in range(6):
            both_products[k] = products[large, k] + products[small, k]
        _principal_axes(pixels[large] + pixels[small], both, both_products, covariance, vectors, axes[i])
        out_low_m[i], out_high_m[i] = min(low_m[large], low_m[small]), max(high_m[large], high_m[small])
        out_sigma_m[i] = max(sigma_m[large], sigma_m[small])
        width_m[i], height_m[i] = _sizes(box_low[i], box_high[i], out_low_m[i], out_high_m[i])


@kernel
def _sizes(box_low, box_high, low_m, high_m):
    x, y = box_high[0] - box_low[0], box_high[1] - box_low[1]
    return max(np.sqrt(x * x + y * y), LEAST_M), max(high_m - low_m, LEAST_M)


@kernel
def _principal_axes(pixels, place, products, covariance, vectors, out):
    # `place` (3,) and `products` (6,) are sums over the points; `covariance` and `vectors` (3, 3) are overwritten.
    per = max(pixels, 1.0)
    at = 0
    for i in range(3):
        for j in range(i, 3):
            covariance[i, j] = covariance[j, i] = products[at] / per - (place[i] / per) * (place[j] / per)
            at += 1
    diagonalise(covariance, vectors)
    for i in range(3):
        out[i] = np.sqrt(max(covariance[i, i], 0.0))
