"""The canonical frame in which an object is fitted, so that fitting is equivariant under rotation of the object.

It is the Manhattan frame: grid-parallel faces have exact seeds and distances. It maximises the sum of fourth powers of
the normals' coordinates, weighted by area, by a fixed point (symmetric FastICA's) that rises, as the sum is convex.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import cos, sin

_ITERATIONS = 40
_AT_REST = 1e-6
# Normals are pooled in bins of this width before the search, and taken one by one for the last steps.
_BIN = 0.08
_BINS = 16  # more bins than from the centre to the end
_FINAL_STEPS = 8
_SETTLED = 1e-12  # reached in three or four steps, since convergence is cubic
_MAX_FINAL = 20_000


def object_axes(vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return (3, 3) right-handed columns: the object's own axes in the frame of its mesh, longest extent first.

    Each points in the direction of the surface's skewness; for a symmetric object the choice is arbitrary.
    """
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    doubled = np.cross(b - a, c - a)
    areas = np.linalg.norm(doubled, axis=1)
    real = areas > 1e-12 * max(float(areas.max(initial=0.0)), 1e-300)
    if not real.any():
        return np.eye(3)
    normals = doubled[real] / areas[real, None]
    areas = areas[real] / areas[real].sum()
    middles = ((a + b + c) / 3)[real]
    return _ordered(_manhattan(normals, areas, middles), vertices, middles, areas)


def _manhattan(
    normals: NDArray[np.float64], areas: NDArray[np.float64], middles: NDArray[np.float64]
) -> NDArray[np.float64]:
    # The three indices of a bin are packed into one number, in the same order: sorting rows takes ten times as long.
    i, j, k = (np.round(normals / _BIN).astype(np.int64) + _BINS).T
    places = (2 * _BINS * i + j) * 2 * _BINS + k
    _, bins = np.unique(places, return_inverse=True)
    sums = [np.bincount(bins, areas * normals[:, i]) for i in range(3)]
    pooled: NDArray[np.float64] = np.stack(sums, axis=1).astype(np.float64)
    weights = np.linalg.norm(pooled, axis=1)
    pooled /= np.maximum(weights, 1e-300)[:, None]
    centered = middles - portable.matmul(areas, middles)
    starts = [portable.eigh(portable.matmul(rows.T * areas, rows))[1] for rows in (normals, centered)]
    axes = np.concatenate([portable.matmul(start, _turns()) for start in starts])
    for _ in range(_ITERATIONS):
        before, axes = axes, _raised(axes, pooled, weights)
        if np.abs(axes - before).max() < _AT_REST:
            break
    squares = np.square(portable.matmul(pooled, axes))
    contrast = portable.matmul(weights, squares * squares).sum(axis=1)
    best = axes[int(np.argmax(np.round(contrast, 9)))][None]
    step = max(1, len(normals) // _MAX_FINAL)
    for _ in range(_FINAL_STEPS):
        before, best = best, _raised(best, normals[::step], areas[::step])
        if np.abs(best - before).max() < _SETTLED:
            break
    return np.asarray(best[0])


def _raised(
    axes: NDArray[np.float64], normals: NDArray[np.float64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    # One step of the fixed point for frames (S, 3, 3).
    # Frames last: what is done for one of them is done for all at once.
    weighted = normals * weights[:, None]
    if len(axes) == 1:
        raised = np.zeros((1, 3, 3))
        _add_raised(np.ascontiguousarray(axes[0]), normals, weighted, raised[0])
        return portable.nearest_orthogonal(raised)
    raised = np.zeros((3, 3, len(axes)))
    _add_all_raised(np.ascontiguousarray(axes.transpose(1, 2, 0)), normals, weighted, np.empty(len(axes)), raised)
    return portable.nearest_orthogonal(raised.transpose(2, 0, 1))


@kernel
def _add_all_raised(axes, normals, weighted, cubes, raised):
    # (3, 3, S) sums of weighted normals (P, 3) times the cubes of their coordinates in frames (3, 3, S).
    for n in range(len(normals)):
        x, y, z = normals[n, 0], normals[n, 1], normals[n, 2]
        for column in range(3):
            for s in range(axes.shape[2]):
                along = x * axes[0, column, s] + y * axes[1, column, s] + z * axes[2, column, s]
                cubes[s] = along * along * along
            for row in range(3):
                share = weighted[n, row]
                for s in range(axes.shape[2]):
                    raised[row, column, s] += share * cubes[s]


@kernel
def _add_raised(axes, normals, weighted, raised):
    for n in range(len(normals)):
        x, y, z = normals[n, 0], normals[n, 1], normals[n, 2]
        for column in range(3):
            along = x * axes[0, column] + y * axes[1, column] + z * axes[2, column]
            cube = along * along * along
            for row in range(3):
                raised[row, column] += weighted[n, row] * cube


def _ordered(
    axes: NDArray[np.float64], vertices: NDArray[np.float64], middles: NDArray[np.float64], areas: NDArray[np.float64]
) -> NDArray[np.float64]:
    extents = np.ptp(portable.matmul(vertices, axes), axis=0)
    axes = axes[:, np.argsort(-extents, kind="stable")]
    local = portable.matmul(middles, axes)
    centered = local - portable.matmul(areas, local)
    cubes = centered * centered * centered
    skew = portable.matmul(areas, cubes)
    # The skewness of a symmetric object is rounding error, which must not decide.
    axes = axes * np.where(skew < -1e-4 * portable.matmul(areas, np.abs(cubes)), -1.0, 1.0)
    # The third axis makes the frame right-handed.
    return np.column_stack([axes[:, 0], axes[:, 1], np.cross(axes[:, 0], axes[:, 1])])


@cache
def _turns() -> NDArray[np.float64]:
    # (T, 3, 3), spread over the rotations that are distinct up to the symmetry of a cube.
    turns = [np.eye(3)]
    for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (1, 1, -1), (1, -1, 1), (-1, 1, 1)):
        for angle in (np.pi / 8, np.pi / 4, 3 * np.pi / 8) if sum(np.abs(axis)) == 1 else (np.pi / 3,):
            k = np.cross(np.eye(3), np.array(axis) / portable.norm(axis))
            turns.append(np.eye(3) - sin(angle) * k + (1 - cos(angle)) * portable.matmul(k, k))
    return np.stack(turns)
