"""The solid envelope of a hollow thing, such as a mug or a bowl: its shape with the cavity filled.

A cell belongs to the cavity if in one plane along the grid all four lines to neighbouring cells meet a wall both ways,
and most of the 26 ways do. The hole of a ring has only the ways in its plane; a corner between walls has no plane.
"""

import numpy as np
import scipy
from numpy.typing import NDArray

from hickory_stream.shapes.sdf import DistanceGrid

_WAYS = 16
# A thing is hollow if it has this many times the volume with its cavity filled.
_HOLLOW = 1.3
# Half the way to the nearest cells, in cells: across a face, an edge, a corner.
_HALF_STEPS = (0.5, 0.7071068, 0.8660254)
# One of each pair of opposite ways to the 26 neighbours: the later one in lexical order.
_DIRECTIONS = np.array([(x, y, z) for x in (0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) > (0, 0, 0)])


def filled(grid: DistanceGrid) -> DistanceGrid | None:
    """Return the field of the solid with its cavity filled, accurate to half a cell there; None if that is little."""
    cells = np.abs(grid.values) / np.float32(grid.step_m)
    is_inside = grid.values < 0
    # A way that crosses the surface has a cell within half a step of it, even where no cell is inside the wall.
    walls = np.stack([is_inside | (cells <= np.float32(reach)) for reach in _HALF_STEPS])
    planes, ways = _blocked(walls)
    is_filled = is_inside | (planes & (ways >= _WAYS))
    # A wall that lies between the cells counts as one cell thick.
    if is_filled.sum() < _HOLLOW * (is_inside | (cells <= 0.5)).sum():
        return None
    depth = scipy.ndimage.distance_transform_edt(is_filled) - 0.5
    away = np.minimum(scipy.ndimage.distance_transform_edt(~is_filled) - 0.5, np.where(is_filled, np.inf, cells))
    values = np.where(is_filled, -depth, away) * grid.step_m
    return DistanceGrid(
        values=np.clip(values, -grid.band_m, grid.band_m).astype(np.float32),
        origin=grid.origin,
        step_m=grid.step_m,
        band_m=grid.band_m,
    )


def _blocked(walls: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.int8]]:
    # Whether all lines of a plane are blocked both ways, and how many of the 26 ways are; walls for ways across a face,
    # an edge, a corner.
    lines, ways = np.zeros((3, *walls.shape[1:]), np.int8), np.zeros(walls.shape[1:], np.int8)
    for direction in _DIRECTIONS:
        is_wall = walls[np.abs(direction).sum() - 1]
        ahead, behind = _met(is_wall, direction), _met(is_wall, -direction)
        ways += ahead
        ways += behind
        lines[direction == 0] += ahead & behind
    return (lines == 4).any(axis=0), ways


def _met(is_wall: NDArray[np.bool_], step: NDArray[np.int64]) -> NDArray[np.bool_]:
    # Whether a wall lies anywhere back along a step: layer by layer along the first axis that it moves along.
    axis = int(np.flatnonzero(step)[0])
    is_met = np.zeros(is_wall.shape, np.bool_)
    walls, met = (np.moveaxis(cells, axis, 0)[:: step[axis]] for cells in (is_wall, is_met))
    shifts = list(zip(np.delete(step, axis).tolist(), met.shape[1:], strict=True))
    to = tuple(slice(max(by, 0), size + min(by, 0)) for by, size in shifts)
    source = tuple(slice(max(-by, 0), size + min(-by, 0)) for by, size in shifts)
    for n in range(1, len(met)):
        met[n][to] = (walls[n - 1] | met[n - 1])[source]
    return is_met
