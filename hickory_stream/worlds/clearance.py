"""Clearance for walking: the distance to the nearest wall or object below eye height, on a grid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.ndimage import distance_transform_edt, label, map_coordinates

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import apply
from hickory_stream.worlds.clutter.footprints import is_inside
from hickory_stream.worlds.scene import part_boxes

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.worlds.scene import World

CELL_M = 0.04
_HEAD_M = 1.8
# Skirting boards are thinner than any clearance that matters.
_SKIRTING_M = 0.02
_STEP_M = 0.12


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Clearance:
    """`distance_m` (nx, ny) to the nearest obstacle; `origin_m` (2,) is the position of the first cell."""

    distance_m: NDArray[np.float64]
    origin_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "distance_m", np.float64, (None, None))
        freeze(self, "origin_m", np.float64, (2,))

    def at(self, points: NDArray[Any]) -> NDArray[np.float64]:
        """Return the clearance at (..., 2) points, 0 outside the grid."""
        cells = (points - self.origin_m) / CELL_M
        return np.asarray(
            map_coordinates(self.distance_m, np.moveaxis(cells, -1, 0), order=1, mode="constant", cval=0.0)
        )

    def cell(self, point: NDArray[Any]) -> tuple[int, int]:
        """Return the cell of an (x, y) point."""
        i, j = np.clip(np.round((np.asarray(point) - self.origin_m) / CELL_M), 0, np.array(self.distance_m.shape) - 1)
        return int(i), int(j)

    def place(self, cell: tuple[int, int]) -> NDArray[np.float64]:
        """Return the position (2,) of a cell."""
        return self.origin_m + CELL_M * np.array(cell, dtype=np.float64)


def clearance_of(world: World) -> Clearance:
    """Return the clearance of a world; the parts of objects and walls below 1.8 m are obstacles."""
    boxes = [box for item in world.objects for box in part_boxes(item.model, item.world_from_object)]
    for model in world.structure:
        if model.kind in ("wall", "door_way"):
            boxes += part_boxes(model, np.eye(4), -_SKIRTING_M)
    return clearance_among(boxes, world.interior_m)


def clearance_among(
    boxes: Sequence[OrientedBox], rectangle_m: tuple[float, float, float, float], outline_m: NDArray[Any] | None = None
) -> Clearance:
    """Return the clearance among boxes within a rectangle, or within an outline (K, 2) in it."""
    x0, y0, x1, y1 = rectangle_m
    xs, ys = np.arange(x0, x1, CELL_M), np.arange(y0, y1, CELL_M)
    is_free = np.ones((len(xs), len(ys)), dtype=bool)
    if outline_m is not None:
        cells = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1)
        is_free &= is_inside(cells.reshape(-1, 2), outline_m).reshape(is_free.shape)
    for box in boxes:
        if box.center[2] - box.half_extents_m[2] >= _HEAD_M:
            continue
        corners = box.corners_world()[:, :2]
        (i0, j0), (i1, j1) = (np.floor((c - (x0, y0)) / CELL_M) for c in (corners.min(axis=0), corners.max(axis=0)))
        rows = slice(max(int(i0), 0), max(int(i1) + 2, 0))
        columns = slice(max(int(j0), 0), max(int(j1) + 2, 0))
        near = np.stack(np.meshgrid(xs[rows], ys[columns], indexing="ij"), axis=-1)
        level = np.concatenate([near, np.full((*near.shape[:2], 1), box.center[2])], axis=-1)
        inside = box.contains(level.reshape(-1, 3)).reshape(near.shape[:2])
        is_free[rows, columns] &= ~inside
    distance = distance_transform_edt(np.pad(is_free, 1))[1:-1, 1:-1] * CELL_M
    return Clearance(distance_m=distance, origin_m=np.array([x0, y0]))


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
            low, high = cells[np.abs(height_m) <= _STEP_M], cells[(height_m > _STEP_M) & (height_m < _HEAD_M)]
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
