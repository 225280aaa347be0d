"""Motions that a scan does not constrain, e.g. along a corridor.

As in X-ICP (Tuna et al., T-RO 2024), translation and rotation apart: for each axis of the point-to-plane problem, the
surfaces that face it are counted. The ratio of eigenvalues is as small in furnished rooms. Only points on surfaces
count: the rings of a LiDAR on a floor are lines with random normals, which move along with the sensor.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    rotation_of_vector,
    rotation_vector,
)

# The least ratio of variances within a surface and across it.
_FLATNESS = 5.0
# The least lever for a rotation: a camera sees little that faces sideways, and noise of normals is a third of it.
_STRONG_LEVER = 0.15


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Surfels:
    """Points with certain normals, (N, 3) each, in the sensor's frame; each stands for `weight` points of the scan."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    weight: float


def surfels_of(points: NDArray[np.float64], neighbors: NDArray[np.int64], stride: int) -> Surfels:
    """Return the points of (N, 3) that lie on a surface, by their `neighbors` (N / stride, K)."""
    around = points[neighbors]
    off = around - around.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.swapaxes(off, 1, 2) @ off)
    is_surface = spread[:, 1] >= _FLATNESS * spread[:, 0]
    return Surfels(points=points[::stride][is_surface], normals=axes[is_surface, :, 0], weight=float(stride))


def degenerate_directions(surfels: Surfels, *, strong_cosine: float, least_strong: float) -> NDArray[np.float64]:
    """Return the unit directions (K, 6), rotation first, for which fewer than `least_strong` points count."""
    # Surfaces that face the motion of their points count for a rotation, by their lever: the median distance is 1.
    points, normals = surfels.points, surfels.normals
    if not len(points):
        return np.eye(6)
    distances = np.sqrt((points * points).sum(axis=1))
    lever = np.cross(points, normals) / max(float(np.median(distances)), 1e-6)
    found = []
    for first, constraints, cosine in ((0, lever, _STRONG_LEVER), (3, normals, strong_cosine)):
        _, axes = portable.eigh(portable.matmul(constraints.T, constraints))
        for axis in axes.T:
            weights = np.abs((constraints * axis).sum(axis=1))
            if surfels.weight * float(weights[weights >= cosine].sum()) < least_strong:
                direction = np.zeros(6)
                direction[first : first + 3] = axis
                found.append(direction)
    return np.array(found).reshape(-1, 6)


def without_degenerate(
    registered: NDArray[np.float64], predicted: NDArray[np.float64], degenerate: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the registered pose (4, 4), with the prediction's part along degenerate directions (K, 6)."""
    # Solution remapping (Zhang, Kaess and Singh, ICRA 2016); directions are the sensor's.
    # Solution remapping (Zhang, Kaess and Singh, ICRA 2016).
    if not len(degenerate):
        return registered
    step = compose(invert(predicted), registered)
    moved = np.concatenate([rotation_vector(step[:3, :3]), step[:3, 3]])
    for direction in degenerate:
        moved = moved - portable.dot(direction, moved) * direction
    return compose(predicted, from_rotation_translation(rotation_of_vector(moved[:3]), moved[3:]))
