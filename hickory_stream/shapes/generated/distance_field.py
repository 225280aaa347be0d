"""The distance to a surface as a grid over it: looked up in nanoseconds, where a search takes microseconds.

A cell with even samples of the surface keeps their mean; every other cell has the distance to the nearest mean.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel

_MARGIN_CELLS = 4
_SAMPLES_PER_CELL = 6
# The fractional parts of these steps fill the unit square evenly (Roberts 2018, after the plastic number).
_STEP_U, _STEP_V = 0.7548776662466927, 0.5698402909980532


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class DistanceField:
    """`distance` (X, Y, Z) float32 at the nodes of a grid: node (0, 0, 0) is at `origin` (3,), the step is `cell`."""

    distance: NDArray[np.float32]
    origin: NDArray[np.float64]
    cell: float


def even_samples(
    vertices: NDArray[Any], faces: NDArray[np.int32], count: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (count, 3) points spread evenly by area over a mesh, deterministic, and their (count,) faces.

    Raises:
        ValueError: the mesh has no area.
    """
    corners = vertices.astype(np.float64)[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    ends = np.cumsum(np.linalg.norm(across, axis=1))
    if not len(ends) or not 0 < ends[-1] < np.inf:
        raise ValueError("the mesh has no area")
    chosen = np.searchsorted(ends, (np.arange(count) + 0.5) / count * ends[-1])
    steps = np.arange(1, count + 1)
    u, v = (steps * _STEP_U) % 1.0, (steps * _STEP_V) % 1.0
    is_beyond = u + v > 1
    u, v = np.where(is_beyond, 1 - u, u), np.where(is_beyond, 1 - v, v)
    a, b, c = corners[chosen, 0], corners[chosen, 1], corners[chosen, 2]
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), chosen.astype(np.int64)


def distance_field(vertices: NDArray[Any], faces: NDArray[np.int32], cells: int) -> DistanceField:
    """Return the distances around a mesh, its longest side divided into `cells`."""
    low, high = vertices.min(axis=0).astype(np.float64), vertices.max(axis=0).astype(np.float64)
    cell = float((high - low).max()) / cells
    origin = low - _MARGIN_CELLS * cell
    shape = tuple(int(n) for n in np.ceil((high - low) / cell) + 2 * _MARGIN_CELLS + 1)
    samples, _ = even_samples(vertices, faces, _SAMPLES_PER_CELL * 3 * cells * cells)
    nodes = np.round((samples - origin) / cell).astype(np.int64)
    flat = np.ravel_multi_index((nodes[:, 0], nodes[:, 1], nodes[:, 2]), shape)
    counts = np.bincount(flat, minlength=int(np.prod(shape)))
    sums = np.stack([np.bincount(flat, weights=samples[:, i], minlength=len(counts)) for i in range(3)], axis=1)
    means = sums / np.maximum(counts, 1)[:, None]
    near = scipy.ndimage.distance_transform_edt(counts.reshape(shape) == 0, return_distances=False, return_indices=True)
    nearest = np.ravel_multi_index(tuple(near), shape)
    places = [origin[i] + cell * np.arange(shape[i]) for i in range(3)]
    squares = np.zeros(shape)
    for i, grid in enumerate(np.meshgrid(*places, indexing="ij", sparse=True)):
        squares += np.square(grid - means[nearest, i])
    return DistanceField(distance=np.sqrt(squares).astype(np.float32), origin=origin, cell=cell)


@kernel
def field_at(distance, origin, cell, x, y, z):
    """Return the distance at a point, interpolated; beyond the grid that at its border and the way there."""
    beyond = 0.0
    base = np.empty(3, np.int64)
    part = np.empty(3)
    for axis in range(3):
        place = ((x if axis == 0 else (y if axis == 1 else z)) - origin[axis]) / cell
        last = distance.shape[axis] - 1
        inside = min(max(place, 0.0), float(last))
        beyond += (place - inside) * (place - inside)
        base[axis] = min(int(inside), last - 1)
        part[axis] = inside - base[axis]
    i, j, k = base[0], base[1], base[2]
    total = 0.0
    for a in range(2):
        wa = part[0] if a else 1.0 - part[0]
        for b in range(2):
            wb = part[1] if b else 1.0 - part[1]
            total += wa * wb * (distance[i + a, j + b, k] * (1.0 - part[2]) + distance[i + a, j + b, k + 1] * part[2])
    return total + cell * np.sqrt(beyond)
