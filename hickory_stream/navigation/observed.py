"""The observed space for a planner: walls, and columns of cells that were not observed.

A column is known if half of the body's height range was observed: behind every edge a small part is occluded.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import cells_of_keys, layers_of_keys
from hickory_stream.navigation.occupancy import GridFrame
from hickory_stream.records import Submap

_SEEN_SHARE = 0.5
# A correction tilts a submap by a milliradian or so; a column of 2 m then leans by 2 mm, less than a voxel is sure to.
_LEAN_VOXELS = 0.25
NO_HULLS = np.empty((0, 8, 3))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Band:
    """The height range of a body in the world."""

    low_m: float
    high_m: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SeenColumns:
    """Convex hulls in the world: `walls` (N, 8, 3), and `is_known` (rows, columns) of the grid."""

    walls: NDArray[np.float64]
    is_known: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self, "walls", np.float64, (None, 8, 3))
        freeze(self, "is_known", np.bool_, (None, None))


def seen_columns(submaps: Sequence[Submap], frame: GridFrame, band: Band, floor_z_m: float) -> SeenColumns:
    """Return the walls and the known columns of the height band on the grid, by all submaps together."""
    walls = [NO_HULLS, *(wall_hulls(submap, band, floor_z_m) for submap in submaps)]
    heights = _heights(submaps, band)
    is_seen = np.zeros((len(heights), frame.rows + 1, frame.columns + 1), bool)
    for submap in submaps:
        rows, columns, is_seen_there = _seen_in(submap, frame, heights)
        is_seen[:, rows, columns] |= is_seen_there
    corners = is_seen.sum(axis=0) >= _SEEN_SHARE * len(heights)
    is_known = corners[1:, 1:] & corners[1:, :-1] & corners[:-1, 1:] & corners[:-1, :-1]
    return SeenColumns(walls=np.concatenate(walls), is_known=is_known)


def wall_hulls(submap: Submap, band: Band, floor_z_m: float) -> NDArray[np.float64]:
    """Return (N, 8, 3) the world corners of boxes that contain all structure in the band except the floor."""
    space = submap.observed_space
    cells = above_floor(space.structure, space.voxel_m, submap.world_from_submap, band, floor_z_m)
    if len(cells) == 0:
        return NO_HULLS
    first = cells.min(axis=0)
    # Voxel by voxel in a tilted submap; if its z axis is vertical, one box per column of voxels suffices.
    if is_upright(submap, band):
        flat = np.zeros(np.ptp(cells[:, :2], axis=0) + 1, bool)
        flat[tuple((cells[:, :2] - first[:2]).T)] = True
        low, high = cells[:, 2].min(), cells[:, 2].max() + 1
        boxes = [(*box, low, high) for box in rectangles(flat)]
        corners = np.array(
            [[x0 + first[0], y0 + first[1], z0, x1 + first[0], y1 + first[1], z1] for x0, y0, x1, y1, z0, z1 in boxes],
            dtype=np.float64,
        )
    else:
        corners = np.concatenate([cells, cells + 1], axis=1).astype(np.float64)
    hulls = box_corners(corners * space.voxel_m)
    return np.asarray(apply(submap.world_from_submap, hulls.reshape(-1, 3)).reshape(-1, 8, 3))


def is_upright(submap: Submap, band: Band) -> bool:
    """Return whether the submap's columns of voxels are vertical, up to a part of a voxel over the band."""
    slope = float(np.linalg.norm(submap.world_from_submap[2, :2]))
    return slope * (band.high_m - band.low_m) <= _LEAN_VOXELS * submap.observed_space.voxel_m


def above_floor(
    keys: NDArray[np.int64], voxel_m: float, world_from_submap: NDArray[np.float64], band: Band, floor_z_m: float
) -> NDArray[np.int64]:
    """Return (N, 3) the cells of the keys whose voxels overlap the band and do not belong to the floor."""
    cells = cells_of_keys(keys)
    centers = apply(world_from_submap, (cells + 0.5) * voxel_m)
    half = 0.5 * voxel_m * float(np.abs(world_from_submap[2, :3]).sum())
    is_floor = np.abs(centers[:, 2] - floor_z_m) <= voxel_m
    is_within = (centers[:, 2] + half > band.low_m + 1e-9) & (centers[:, 2] - half < band.high_m - 1e-9)
    return np.asarray(cells[is_within & ~is_floor])


def unknown_hulls(is_known: NDArray[np.bool_], frame: GridFrame, band: Band) -> NDArray[np.float64]:
    """Return (N, 8, 3) the corners of boxes that contain the unknown cells."""
    boxes = rectangles(~is_known.T)
    if not boxes:
        return NO_HULLS
    flat = np.array(boxes, dtype=np.float64) * frame.cell_m + np.tile(frame.origin_m, 2)
    low, high = np.full(len(flat), band.low_m), np.full(len(flat), band.high_m)
    return box_corners(np.column_stack([flat[:, :2], low, flat[:, 2:], high]))


def rectangles(mask: NDArray[np.bool_]) -> list[tuple[int, int, int, int]]:
    """Return few rectangles (first, second, first end, second end) that make up a mask: runs, and equal runs joined."""
    found: list[tuple[int, int, int, int]] = []
    open_runs: dict[tuple[int, int], int] = {}
    # With an empty row at the end, which ends all runs.
    edges = np.argwhere(np.diff(np.pad(mask, ((0, 1), (1, 1))).astype(np.int8))).reshape(-1, 2, 2)
    runs_of: list[set[tuple[int, int]]] = [set() for _ in range(len(mask) + 1)]
    for (i, a), (_, b) in edges.tolist():
        runs_of[i].add((a, b))
    for i, runs in enumerate(runs_of):
        ended = [run for run in open_runs if run not in runs]
        found += [(open_runs.pop(run), run[0], i, run[1]) for run in ended]
        for run in sorted(runs):
            open_runs.setdefault(run, i)
    return found


def box_corners(bounds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 8, 3) corners of boxes (N, 6): low corner, high corner."""
    picks = np.array([[3 * (k >> axis & 1) + axis for axis in range(3)] for k in range(8)])
    return bounds[:, picks]


def _heights(submaps: Sequence[Submap], band: Band) -> NDArray[np.float64]:
    voxel_m = min((submap.observed_space.voxel_m for submap in submaps), default=band.high_m - band.low_m)
    count = max(round((band.high_m - band.low_m) / voxel_m), 1)
    return np.asarray(band.low_m + (np.arange(count) + 0.5) * (band.high_m - band.low_m) / count)


def _seen_in(submap: Submap, frame: GridFrame, heights: NDArray[np.float64]) -> tuple[slice, slice, NDArray[np.bool_]]:
    # The rows and columns of corners of cells where a submap may have seen, and (L, R, C) whether it did.
    space = submap.observed_space
    # The submap's z axis is nearly vertical: heights in the submap and the world differ by a constant.
    layers = np.floor((heights - submap.world_from_submap[2, 3]) / space.voxel_m + 1e-9).astype(np.int64)
    first, seen = _seen_columns_of(space.free, space.structure, layers)
    rows, columns = _corners_around(submap, first, seen.shape[1:], frame, heights[0])
    x = frame.origin_m[0] + np.arange(columns.start, columns.stop) * frame.cell_m
    y = frame.origin_m[1] + np.arange(rows.start, rows.stop) * frame.cell_m
    places = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), heights[0])], axis=-1).reshape(-1, 3)
    local = apply(invert(submap.world_from_submap), places)[:, :2]
    column = np.floor(local / space.voxel_m).astype(np.int64) - first
    is_inside = ((column >= 0) & (column < seen.shape[1:])).all(axis=1)
    is_seen = np.zeros((len(layers), len(column)), bool)
    is_seen[:, is_inside] = seen[:, column[is_inside, 0], column[is_inside, 1]]
    return rows, columns, is_seen.reshape(len(layers), len(y), len(x))


def _corners_around(
    submap: Submap, first: NDArray[np.int64], shape: tuple[int, ...], frame: GridFrame, z_m: float
) -> tuple[slice, slice]:
    low, high = first * submap.observed_space.voxel_m, (first + shape) * submap.observed_space.voxel_m
    across = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
    turn, off = submap.world_from_submap[:3, :3], submap.world_from_submap[:3, 3]
    up = (z_m - off[2] - across @ turn[2, :2]) / turn[2, 2]
    places = (np.column_stack([across, up]) @ turn.T + off)[:, :2]
    # One more on each side: the same places are computed in another way here.
    begin = np.floor((places.min(axis=0) - frame.origin_m) / frame.cell_m).astype(int) - 1
    end = np.ceil((places.max(axis=0) - frame.origin_m) / frame.cell_m).astype(int) + 2
    count = np.array([frame.columns + 1, frame.rows + 1])
    (left, bottom), (right, top) = np.clip(begin, 0, count), np.clip(end, 0, count)
    return slice(int(bottom), int(max(bottom, top))), slice(int(left), int(max(left, right)))


def _seen_columns_of(
    free: NDArray[np.int64], structure: NDArray[np.int64], layers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    # The first column (2,), and (L, X, Y) which voxels of these layers were seen.
    cells = []
    for keys in (free, structure):
        layer = layers_of_keys(keys)
        cells.append(cells_of_keys(keys[(layer >= layers.min()) & (layer <= layers.max())]))
    found = np.concatenate(cells)
    if len(found) == 0:
        return np.zeros(2, np.int64), np.zeros((len(layers), 0, 0), bool)
    first = found.min(axis=0)
    first[2] = layers.min()
    shape = np.maximum(np.ptp(found, axis=0) + 1, [1, 1, layers.max() - layers.min() + 1])
    seen = np.zeros(shape, bool)
    seen[tuple((found - first).T)] = True
    return first[:2], np.moveaxis(seen[:, :, layers - layers.min()], 2, 0)
