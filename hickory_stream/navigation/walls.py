"""Walls as few long boxes, for simulators: observed structure without the noise of a camera.

A planner takes every column with a structure voxel as a wall (`observed.wall_hulls`), which is safe. As bodies, noisy
columns would be posts before the walls: here a wall needs a third of its column observed, including its upper part.
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value, world_bounds
from hickory_stream.geometry.voxels import cells_of_keys
from hickory_stream.navigation.observed import Band, box_corners, is_upright
from hickory_stream.records import Submap

_WALL_SHARE, _WALL_TOP = 0.3, 0.7
_LEAST_VOXELS = 27
_ORDERS = np.array([[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]])


def wall_boxes(
    submaps: Sequence[Submap], band: Band, floor_z_m: float, objects: Sequence[Superquadrics] = ()
) -> NDArray[np.float64]:
    """Return corners (N, 8, 3), in the world, of boxes whose union is the walls in the band, outside of `objects`."""
    # Once for all submaps: each is compared with every object.
    bounds = [world_bounds(primitives).reshape(-1, 3) for primitives in objects]
    lows = np.array([bound.min(axis=0) for bound in bounds]).reshape(-1, 3)
    highs = np.array([bound.max(axis=0) for bound in bounds]).reshape(-1, 3)

    def is_within(points: NDArray[np.float64]) -> NDArray[np.bool_]:
        found = np.zeros(len(points), bool)
        least, most = points.min(axis=0, initial=np.inf), points.max(axis=0, initial=-np.inf)
        for k in np.flatnonzero(((lows <= most) & (highs >= least)).all(axis=1)).tolist():
            near = np.flatnonzero(((points >= lows[k]) & (points <= highs[k])).all(axis=1))
            for i in range(len(objects[k])):
                found[near] |= implicit_value(objects[k], i, points[near]) <= 1
        return found

    boxes = [_boxes_in(submap, band, floor_z_m, is_within) for submap in submaps]
    return np.concatenate([np.empty((0, 8, 3)), *boxes])


def _boxes_in(
    submap: Submap, band: Band, floor_z_m: float, is_within: Callable[[NDArray[np.float64]], NDArray[np.bool_]]
) -> NDArray[np.float64]:
    space = submap.observed_space
    cells = cells_of_keys(space.structure)
    centers = apply(submap.world_from_submap, (cells + 0.5) * space.voxel_m)
    is_floor = np.abs(centers[:, 2] - floor_z_m) <= space.voxel_m
    is_wanted = (centers[:, 2] > band.low_m) & (centers[:, 2] < band.high_m) & ~is_floor
    cells = cells[is_wanted][~is_within(centers[is_wanted])]
    if len(cells) == 0:
        return np.empty((0, 8, 3))
    first = cells.min(axis=0)
    mask = _mask_of(cells, first, np.ptp(cells, axis=0) + 1)
    free = _mask_of(cells_of_keys(space.free), first, np.array(mask.shape))
    if is_upright(submap, band):
        layers = (band.high_m - max(band.low_m, floor_z_m + space.voxel_m)) / space.voxel_m
        is_wall = mask.sum(axis=2) >= _WALL_SHARE * layers
        is_wall &= mask[:, :, int(_WALL_TOP * layers) :].any(axis=2)
    else:
        # The columns of a tilted grid are not vertical.
        is_wall = np.zeros(mask.shape[:2], bool)
    corners = boxes_of(_cleaned(mask, free, is_wall)).astype(np.float64) + np.tile(first, 2)
    hulls = box_corners(corners * space.voxel_m)
    return np.asarray(apply(submap.world_from_submap, hulls.reshape(-1, 3)).reshape(-1, 8, 3))


def boxes_of(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return low and high corners (N, 6), in cells, of few boxes whose union is an (X, Y, Z) mask, found greedily."""
    return _boxes_of(np.ascontiguousarray(mask), _ORDERS)


def _mask_of(cells: NDArray[np.int64], first: NDArray[np.int64], shape: NDArray[np.int64]) -> NDArray[np.bool_]:
    mask = np.zeros(shape, bool)
    local = cells - first
    mask[tuple(local[((local >= 0) & (local < shape)).all(axis=1)].T)] = True
    return mask


def _cleaned(mask: NDArray[np.bool_], free: NDArray[np.bool_], is_wall: NDArray[np.bool_]) -> NDArray[np.bool_]:
    # Walls from bottom to top and larger pieces of other structure; gaps of one voxel are filled unless observed free.
    from scipy import ndimage

    walls = np.broadcast_to(is_wall[..., None], mask.shape)
    cube = np.ones((3, 3, 3), bool)
    pieces, _ = ndimage.label(mask & ~walls, cube)
    is_large = np.bincount(pieces.ravel()) >= _LEAST_VOXELS
    is_large[0] = False
    kept = walls | is_large[pieces]
    closed = ndimage.binary_closing(np.pad(kept, 1), cube)[1:-1, 1:-1, 1:-1]
    return np.asarray(kept | (closed & ~free))


@kernel
def _boxes_of(mask, orders):
    left = mask.copy()
    found = np.empty((256, 6), np.int64)
    count = 0
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    best = np.empty(6, np.int64)
    for x in range(mask.shape[0]):
        for y in range(mask.shape[1]):
            for z in range(mask.shape[2]):
                if not left[x, y, z]:
                    continue
                most = 0
                for order in orders:
                    low[0], low[1], low[2] = x, y, z
                    high[0], high[1], high[2] = x + 1, y + 1, z + 1
                    for axis in order:
                        _grow(mask, low, high, axis)
                    new = 0
                    for i in range(low[0], high[0]):
                        for j in range(low[1], high[1]):
                            for k in range(low[2], high[2]):
                                new += left[i, j, k]
                    if new > most:
                        most = new
                        best[:3], best[3:] = low, high
                left[best[0] : best[3], best[1] : best[4], best[2] : best[5]] = False
                if count == len(found):
                    larger = np.empty((2 * count, 6), np.int64)
                    larger[:count] = found
                    found = larger
                found[count] = best
                count += 1
    return found[:count]


@kernel
def _grow(mask, low, high, axis):
    while high[axis] < mask.shape[axis] and _is_full(mask, low, high, axis, high[axis]):
        high[axis] += 1
    while low[axis] > 0 and _is_full(mask, low, high, axis, low[axis] - 1):
        low[axis] -= 1


@kernel
def _is_full(mask, low, high, axis, place):
    first, end = low.copy(), high.copy()
    first[axis], end[axis] = place, place + 1
    for i in range(first[0], end[0]):
        for j in range(first[1], end[1]):
            for k in range(first[2], end[2]):
                if not mask[i, j, k]:
                    return False
    return True
