"""Which motions a scan says nothing about: in a corridor it looks the same wherever one stands along it.

As X-ICP does it (Tuna et al., T-RO 2024), translation and rotation apart: the axes of the points' constraints are
those of the point-to-plane problem, and for each is counted what surfaces face it. The ratio of eigenvalues does not
do: it is as small in furnished rooms, and in a corridor the noise of the walls' normals keeps it from being smaller.

Only points whose surroundings are a surface are counted. The rings of a LiDAR on a floor are lines, each with a normal
by chance; they go along with the sensor and hold a registration where it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    rotation_of_vector,
    rotation_vector,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

_FLATNESS = 5.0
"""The least ratio of variances within a surface and across it."""

_STRONG_LEVER = 0.15
"""What a point says of a rotation: a camera sees little that faces sideways, and noise of normals is a third of it."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Surfels:
    """Points with certain normals, (N, 3) each, in the sensor's frame; each stands for `weight` points of the scan."""

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    weight: float


def surfels_of(points: NDArray[np.float64], neighbors: NDArray[np.int64], stride: int) -> Surfels:
    """Return of points (N, 3), each of which has `neighbors` (N / stride, K), those that lie on a surface."""
    around = points[neighbors]
    off = around - around.mean(axis=1, keepdims=True)
    spread, axes = np.linalg.eigh(np.swapaxes(off, 1, 2) @ off)
    is_surface = spread[:, 1] >= _FLATNESS * spread[:, 0]
    return Surfels(points=points[::stride][is_surface], normals=axes[is_surface, :, 0], weight=float(stride))


def degenerate_directions(surfels: Surfels, *, strong_cosine: float, least_strong: float) -> NDArray[np.float64]:
    """Return the directions (K, 6) for which fewer than `least_strong` points speak, unit, rotation first.

    A rotation about an axis is spoken for by surfaces that face
    the way that their points would go, with the weight of their lever: the median distance counts 1.
    """
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
    """Return the registered pose (4, 4), along degenerate directions (K, 6) of the sensor that of the prediction.

    Solution remapping (Zhang, Kaess and Singh, ICRA 2016).
    """
    if not len(degenerate):
        return registered
    step = compose(invert(predicted), registered)
    moved = np.concatenate([rotation_vector(step[:3, :3]), step[:3, 3]])
    for direction in degenerate:
        moved = moved - portable.dot(direction, moved) * direction
    return compose(predicted, from_rotation_translation(rotation_of_vector(moved[:3]), moved[3:]))
