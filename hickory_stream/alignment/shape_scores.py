"""Similarity of shapes: an (N, M) matrix of scores in 0..1 for each way to compare the objects of two maps.

`superquadric_scores` is our own; `literal_scores` is Eq. (sgeo) of the paper to the letter; `box_scores` is Mesh-BBox;
`point_scores` are ROMAN's attributes of the point cloud. NaN if one object lacks the data.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.object_map import ObjectMap, shape_box
from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.superquadric import Superquadrics, volumes_m3

# Standard deviations of the literal score and of our kernel (exponents, logarithms of lengths); the weight of a
# primitive is its share of volume to this power, below 1 so that small parts count.
_SIGMA_EXPONENTS = 1.0
_EXPONENT_SIGMA, _LOG_REACH_SIGMA, _SHARE_POWER = 1.0, 0.2, 0.25
_FAR_SQUARE = 30.0
_MIN_POINTS = 4


def superquadric_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) kernels of layer 3: the similarity of two sets of primitives, in any order and number.

    A primitive is a point of five coordinates: the logarithms of its vertical and its two horizontal extents, and its
    exponents. The score is the cosine between sums of Gaussian kernels: a missing primitive reduces it by its share.
    """
    a, b = _primitive_sets(map_a.shapes), _primitive_sets(map_b.shapes)
    scores = _kernels(*a, *b)
    own_a, own_b = np.diagonal(_kernels(*a, *a, True)), np.diagonal(_kernels(*b, *b, True))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(scores / np.sqrt(np.multiply.outer(own_a, own_b)))


def literal_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) scores of Eq. (sgeo), sigma_geo = 1: the first K primitives of both, K the smaller count.

    Weights are the mean of both objects' shares of volume, and sum to less than 1 if the counts differ.
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
    return np.where(np.logical_and.outer(counts_a > 0, counts_b > 0), scores, np.nan)


def box_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) mean ratios of the sides of the bounding boxes: horizontal sides by length, then the height."""
    a, b = _box_sides(map_a), _box_sides(map_b)
    return np.asarray((np.minimum(a[:, None], b[None]) / np.maximum(a[:, None], b[None])).mean(axis=2))


def point_scores(map_a: ObjectMap, map_b: ObjectMap) -> NDArray[np.float64]:
    """Return the (N, M) geometric means of the ratios of linearity, planarity, scattering and volume (ROMAN)."""
    a, b = _point_attributes(map_a), _point_attributes(map_b)
    small, large = np.minimum(a[:, None], b[None]), np.maximum(a[:, None], b[None])
    return np.asarray((small / np.maximum(large, 1e-9)).prod(axis=2) ** 0.25)


def _primitive_sets(
    shapes: Sequence[Superquadrics | None],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    # Points (P, 5) and weights (P,) of all primitives, and the first index of each object (N + 1,).
    counts = [0 if shape is None else len(shape) for shape in shapes]
    known = [shape for shape in shapes if shape is not None and len(shape)]
    if not known:
        return np.empty((0, 5)), np.empty(0), np.zeros(len(shapes) + 1, dtype=np.int64)
    exponents = np.concatenate([shape.exponents for shape in known])
    axes = np.concatenate([shape.semi_axes_m for shape in known])
    rotations = np.concatenate([shape.world_from_local[:, :3, :3] for shape in known])
    scaled = rotations * axes[:, None]
    spread = scaled @ scaled.transpose(0, 2, 1)
    # The eigenvalues of the horizontal 2 x 2 block, in closed form.
    middle, half = (spread[:, 0, 0] + spread[:, 1, 1]) / 2, (spread[:, 0, 0] - spread[:, 1, 1]) / 2
    radius = np.hypot(half, spread[:, 0, 1])
    reach = np.column_stack([spread[:, 2, 2], middle + radius, middle - radius])
    points = np.column_stack([np.log(np.maximum(reach, 1e-8)) / (2 * _LOG_REACH_SIGMA), exponents / _EXPONENT_SIGMA])
    starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    volumes = np.concatenate([volumes_m3(shape) for shape in known])
    totals = np.add.reduceat(volumes, starts[:-1][np.array(counts) > 0])
    shares = volumes / np.repeat(totals, [count for count in counts if count])
    return points, shares**_SHARE_POWER, starts


@kernel
def _kernels(points_a, weights_a, starts_a, points_b, weights_b, starts_b, only_diagonal=False):
    # (N, M) sums of Gaussian kernels between all primitives of two objects.
    sums = np.zeros((len(starts_a) - 1, len(starts_b) - 1))
    for i in range(sums.shape[0]):
        for j in range(sums.shape[1]):
            if only_diagonal and i != j:
                continue
            total = 0.0
            for p in range(starts_a[i], starts_a[i + 1]):
                for q in range(starts_b[j], starts_b[j + 1]):
                    square = 0.0
                    for c in range(points_a.shape[1]):
                        square += (points_a[p, c] - points_b[q, c]) ** 2
                    if square < _FAR_SQUARE:
                        total += weights_a[p] * weights_b[q] * np.exp(-0.5 * square)
            sums[i, j] = total
    return sums


def _padded(
    shapes: Sequence[Superquadrics | None],
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    # Exponents (N, K, 2), semi-axes (N, K, 3), shares of volume (N, K), zero beyond the counts (N,).
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
    boxes = [
        box if shape is None else shape_box(shape) for shape, box in zip(objects.shapes, objects.boxes, strict=True)
    ]
    half = np.array([box.half_extents_m for box in boxes]).reshape(-1, 3)
    return np.column_stack([np.sort(half[:, :2], axis=1), half[:, 2]])


def _point_attributes(objects: ObjectMap) -> NDArray[np.float64]:
    # (N, 4): linearity, planarity and scattering of the covariance, and the volume of the box.
    rows = np.full((len(objects), 4), np.nan)
    for row, points, box in zip(rows, objects.points, objects.boxes, strict=True):
        if points is not None and len(points) >= _MIN_POINTS:
            third, second, first = np.maximum(np.linalg.eigvalsh(np.cov(points.T.astype(np.float64))), 1e-12)
            row[:] = (first - second) / first, (second - third) / first, third / first, box.volume_m3
    return rows
