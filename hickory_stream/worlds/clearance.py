"""Clearance for walking: the distance to the nearest wall or object below eye height, on a grid."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, map_coordinates

from hickory_stream.geometry.arrays import freeze_all
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.worlds.scene import World, part_boxes

CELL_M = 0.04
HEAD_M = 1.8
# Skirting boards are thinner than any clearance that matters.
_SKIRTING_M = 0.02


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Clearance:
    """`distance_m` (nx, ny) to the nearest obstacle; `origin_m` (2,) is the position of the first cell."""

    distance_m: NDArray[np.float64]
    origin_m: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, distance_m=(None, None), origin_m=(2,))

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
        if box.center[2] - box.half_extents_m[2] >= HEAD_M:
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


def is_inside(points: NDArray[np.float64], outline: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return (N,) whether (N, 2) points lie in a simple outline (K, 2)."""
    inside = np.zeros(len(points), dtype=bool)
    x, y = points[:, 0], points[:, 1]
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0), strict=True):
        crosses = (ay > y) != (by > y)
        if ay != by:
            inside ^= crosses & (x < (bx - ax) * (y - ay) / (by - ay) + ax)
    return inside
