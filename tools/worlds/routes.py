"""Routes over a floor with clearance from the objects on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter1d, label

from hickory_stream.geometry.rigid import apply
from hickory_stream.worlds.clearance import CELL_M, HEAD_M, Clearance, clearance_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.scene import World

_STEP_M = 0.12


def way_between(clearance: Clearance, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a short path (N, 2) with clearance between two positions, None if there is none."""
    from skimage.graph import route_through_array

    distance = clearance.distance_m
    cost = np.where(distance >= 0.2, 1.0 + 6.0 * np.maximum(0.0, 0.5 - distance) / 0.5, 1e6)
    cells, total = route_through_array(cost, clearance.cell(a), clearance.cell(b), geometric=True)
    if total >= 1e6:
        return None
    return clearance.origin_m + CELL_M * np.array(cells, dtype=np.float64)


def smoothed(route: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a closed route smoothed over about a third of a metre, to remove the steps of the grid."""
    line = gaussian_filter1d(route, 8.0, axis=0, mode="wrap")
    return np.vstack([line, line[:1]])


def clearance_of_surfaces(world: World) -> Clearance:
    """Return the clearance of a world of any meshes: free is floor at z = 0 with no surface up to 1.8 m above it.

    Surfaces are looked at in points of half a cell; what is lower than a doorstep can be walked over.
    """
    x0, y0, x1, y1 = world.interior_m
    shape = (int(np.ceil((x1 - x0) / CELL_M)), int(np.ceil((y1 - y0) / CELL_M)))
    has_floor, is_blocked = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    placed = [(model, np.eye(4)) for model in world.structure]
    placed += [(item.model, item.world_from_object) for item in world.objects]
    for model, world_from_model in placed:
        for part in model.parts:
            points = _points_on(apply(world_from_model, part.vertices)[part.faces], CELL_M / 2)
            cells = np.floor((points[:, :2] - (x0, y0)) / CELL_M).astype(np.int64)
            inside = ((cells >= 0) & (cells < shape)).all(axis=1)
            cells, height_m = cells[inside], points[inside, 2]
            low, high = cells[np.abs(height_m) <= _STEP_M], cells[(height_m > _STEP_M) & (height_m < HEAD_M)]
            has_floor[low[:, 0], low[:, 1]] = True
            is_blocked[high[:, 0], high[:, 1]] = True
    distance = distance_transform_edt(np.pad(has_floor & ~is_blocked, 1))[1:-1, 1:-1] * CELL_M
    return Clearance(distance_m=distance, origin_m=np.array([x0, y0]))


def _points_on(triangles: NDArray[np.float64], spacing_m: float) -> NDArray[np.float64]:
    """Return (N, 3) points on (F, 3, 3) triangles, on every triangle on a grid of at most the spacing."""
    a, edges = triangles[:, 0], triangles[:, 1:] - triangles[:, :1]
    sides_m = np.linalg.norm(np.concatenate([edges, edges[:, 1:] - edges[:, :1]], axis=1), axis=2)
    steps = np.maximum(1, np.ceil(sides_m.max(axis=1, initial=0.0) / spacing_m)).astype(np.int64)
    points = [np.empty((0, 3))]
    for count in np.unique(steps):
        chosen = steps == count
        u, v = np.meshgrid(*2 * [np.linspace(0.0, 1.0, count + 1)], indexing="ij")
        weights = np.stack([u, v], axis=-1).reshape(-1, 2)
        weights = weights[weights.sum(axis=1) <= 1.0 + 1e-9]
        points.append((a[chosen, None] + weights @ edges[chosen]).reshape(-1, 3))
    return np.concatenate(points)


def joins_rooms(world: World, clearance_m: float) -> bool:
    """Return whether one connected area of a given clearance reaches every room, to half a metre from its walls."""
    clearance = clearance_of(world)
    pieces, count = label(clearance.distance_m >= clearance_m)
    xs = clearance.origin_m[0] + CELL_M * np.arange(pieces.shape[0])
    ys = clearance.origin_m[1] + CELL_M * np.arange(pieces.shape[1])
    common = set(range(1, count + 1))
    for x0, y0, x1, y1 in world.rooms_m:
        within = pieces[np.ix_((xs > x0 + 0.5) & (xs < x1 - 0.5), (ys > y0 + 0.5) & (ys < y1 - 0.5))]
        common &= set(np.unique(within[within > 0]).tolist())
    return bool(common)
