"""How alike two objects are in shape: one (N, M) matrix of scores in 0..1 for each way to compare them.

`superquadric_scores` is ours; `literal_scores` is Eq. (sgeo) of the paper as it stands; `box_scores` is Mesh-BBox;
`point_scores` are ROMAN's attributes of the cloud. A pair of which one object lacks what is compared scores NaN.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.superquadric import Superquadrics, volumes_m3

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.alignment.object_map import ObjectMap

_SIGMA_EXPONENTS = 1.0
_MIN_POINTS = 4


def superquadric_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) scores of layer 3, whatever its decomposition: volume and spread along and across gravity."""
    a, b = _signatures(map_a.shapes), _signatures(map_b.shapes)
    return np.exp(-np.abs(a[:, None] - b[None]).mean(axis=2) / 0.25)


def literal_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) scores of Eq. (sgeo): the first K primitives of both, weighted by their share of volume.

    K is the smaller of the two counts, sigma_geo is 1; the weights are the mean of both objects' shares of volume, and
    sum to less than 1 where primitives are left over.
    """
    exponents_a, axes_a, weights_a, counts_a = _padded(map_a.shapes)
    exponents_b, axes_b, weights_b, counts_b = _padded(map_b.shapes)
    scores = np.zeros((len(map_a), len(map_b)))
    for k in range(min(counts_a.max(initial=0), counts_b.max(initial=0))):
        difference = np.abs(exponents_a[:, None, k] - exponents_b[None, :, k]).sum(axis=2)
        small = np.minimum(axes_a[:, None, k], axes_b[None, :, k])
        large = np.maximum(axes_a[:, None, k], axes_b[None, :, k])
        ratio = (small / np.maximum(large, 1e-9)).mean(axis=2)
        weight = (weights_a[:, None, k] + weights_b[None, :, k]) / 2
        both = np.minimum.outer(counts_a, counts_b) > k
        scores += np.where(both, weight * np.exp(-difference / _SIGMA_EXPONENTS) * ratio, 0.0)
    return _known(scores, counts_a > 0, counts_b > 0)


def box_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) mean ratios of the sides of the bounding boxes, level sides by length, then the height."""
    a, b = _box_sides(map_a), _box_sides(map_b)
    return np.asarray((np.minimum(a[:, None], b[None]) / np.maximum(a[:, None], b[None])).mean(axis=2))


def point_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) geometric means of the ratios of linearity, planarity, scattering and volume (ROMAN)."""
    a, b = _point_attributes(map_a), _point_attributes(map_b)
    small, large = np.minimum(a[:, None], b[None]), np.maximum(a[:, None], b[None])
    return np.asarray((small / np.maximum(large, 1e-9)).prod(axis=2) ** 0.25)


# ---- attributes of one object ---------------------------------------------------------------------------------------


def _signatures(shapes: Sequence[Superquadrics | None]) -> NDArray[np.float64]:
    rows = np.full((len(shapes), 4), np.nan)
    for row, shape in zip(rows, shapes, strict=True):
        if shape is not None:
            weights = volumes_m3(shape)
            centers = shape.world_from_local[:, :3, 3]
            mean = weights @ centers / weights.sum()
            own = shape.world_from_local[:, :3, :3] * shape.semi_axes_m[:, None] / 2
            spread = (centers - mean)[:, :, None] * (centers - mean)[:, None] + own @ own.transpose(0, 2, 1)
            covariance = np.tensordot(weights / weights.sum(), spread, axes=1)
            level = np.linalg.eigvalsh(covariance[:2, :2])
            row[:] = np.log(weights.sum()) / 3, *(np.log(np.maximum((*level, covariance[2, 2]), 1e-8)) / 2)
    return rows


def _padded(
    shapes: Sequence[Superquadrics | None],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Return exponents (N, K, 2), semi-axes (N, K, 3), shares of volume (N, K), zero beyond the counts (N,)."""
    counts = np.array([0 if shape is None else len(shape) for shape in shapes], dtype=np.int64)
    most = int(counts.max(initial=0))
    exponents, axes = np.zeros((len(shapes), most, 2)), np.zeros((len(shapes), most, 3))
    weights = np.zeros((len(shapes), most))
    for i, shape in enumerate(shapes):
        if shape is not None:
            volumes = volumes_m3(shape)
            exponents[i, : len(shape)], axes[i, : len(shape)] = shape.exponents, shape.semi_axes_m
            weights[i, : len(shape)] = volumes / volumes.sum()
    return exponents, axes, weights, counts


def _box_sides(objects: ObjectMap) -> NDArray[np.float64]:
    half = np.array([box.half_extents_m for box in objects.boxes]).reshape(-1, 3)
    return np.column_stack([np.sort(half[:, :2], axis=1), half[:, 2]])


def _point_attributes(objects: ObjectMap) -> NDArray[np.float64]:
    """Return (N, 4) linearity, planarity, scattering of the cloud's covariance, and the volume of its box."""
    rows = np.full((len(objects), 4), np.nan)
    for row, points, box in zip(rows, objects.points, objects.boxes, strict=True):
        if points is not None and len(points) >= _MIN_POINTS:
            third, second, first = np.maximum(np.linalg.eigvalsh(np.cov(points.T.astype(np.float64))), 1e-12)
            row[:] = (first - second) / first, (second - third) / first, third / first, box.volume_m3
    return rows


def _known(
    scores: NDArray[np.float64], has_a: NDArray[np.bool_], has_b: NDArray[np.bool_]
) -> NDArray[np.float64]:
    return np.where(np.logical_and.outer(has_a, has_b), scores, np.nan)
