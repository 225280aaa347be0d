"""The solid envelope of a hollow thing, such as a mug or a bowl: its shape with the cavity filled.

A cell belongs to the cavity if in one plane along the grid all four lines to neighbouring cells meet a wall both ways,
and most of the 26 ways do. The hole of a ring has only the ways in its plane; a corner between walls has no plane.
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from hickory_stream.base.compiled import kernel
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
    planes, ways = _blocked(walls, _DIRECTIONS)
    is_filled = is_inside | (planes & (ways >= _WAYS))
    # A wall that lies between the cells counts as one cell thick.
    if is_filled.sum() < _HOLLOW * (is_inside | (cells <= 0.5)).sum():
        return None
    depth = ndimage.distance_transform_edt(is_filled) - 0.5
    away = np.minimum(ndimage.distance_transform_edt(~is_filled) - 0.5, np.where(is_filled, np.inf, cells))
    values = np.where(is_filled, -depth, away) * grid.step_m
    return DistanceGrid(
        values=np.clip(values, -grid.band_m, grid.band_m).astype(np.float32),
        origin=grid.origin,
        step_m=grid.step_m,
        band_m=grid.band_m,
    )


@kernel
def _blocked(walls, directions):
    # Whether all lines of a plane are blocked both ways, and how many of the 26 ways are.
    shape = walls.shape[1:]
    size = shape[0] * shape[1] * shape[2]
    lines, ways = np.zeros((size, 3), np.int8), np.zeros(size, np.int8)
    for direction in directions:
        is_wall = walls[np.abs(direction).sum() - 1]
        ahead, behind = _met(is_wall, direction, True).ravel(), _met(is_wall, direction, False).ravel()
        for n in range(size):
            ways[n] += np.int8(ahead[n]) + np.int8(behind[n])
            if ahead[n] and behind[n]:
                for axis in range(3):
                    lines[n, axis] += direction[axis] == 0
    planes = np.zeros(size, np.bool_)
    for n in range(size):
        planes[n] = lines[n, 0] == 4 or lines[n, 1] == 4 or lines[n, 2] == 4
    return planes.reshape(shape), ways.reshape(shape)


@kernel
def _met(is_wall, direction, is_backward):
    shape = is_wall.shape
    met = np.zeros(shape, np.bool_)
    sign = 1 if is_backward else -1
    dx, dy, dz = sign * direction[0], sign * direction[1], sign * direction[2]
    for a in range(shape[0]):
        # The direction is the later one in lexical order, so that the cell before was seen to.
        i = a if is_backward else shape[0] - 1 - a
        for b in range(shape[1]):
            j = b if is_backward else shape[1] - 1 - b
            for c in range(shape[2]):
                k = c if is_backward else shape[2] - 1 - c
                x, y, z = i - dx, j - dy, k - dz
                if 0 <= x < shape[0] and 0 <= y < shape[1] and 0 <= z < shape[2]:
                    met[i, j, k] = is_wall[x, y, z] or met[x, y, z]
    return met
