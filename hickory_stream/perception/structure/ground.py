"""Ground that is not one level plane: slopes, waves, kerbs, steps and ramps, on a grid of heights.

The lowest upward-facing surfaces of cells grow into regions of limited slope (local slopes: Himmelsbach et al. 2010;
regions of a height map: Douillard et al. 2011). Ground is a region at the height of the floor, on known ground, or one
step above ground and wide enough to stand on, or up to two steps below. Objects are steeper, higher or smaller.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.perception.surface import Surface

# Side of a cell of the height grid.
_CELL_M = 0.2
# Minimum area of a level that is a step higher than the ground beside it.
_LEVEL_M2 = 1.5
# Maximum horizontal distance between such a level and that ground: an object may occlude the edge.
_GAP_M = 1.0
# The ground is uneven if at least this area is this far from one plane.
_OFF_PLANE_M = 0.05
_OFF_PLANE_M2 = 1.0


@dataclass(frozen=True, kw_only=True, slots=True)
class GroundConfig(Ranged):
    """Which surfaces are ground (traversable on foot)."""

    #: Maximum slope between neighbouring cells, as a ratio: a ramp of 20 degrees.
    slope: float = number(0.36, 0, 10, "ratio")
    #: Maximum height of a step or a kerb.
    step_m: float = number(0.2, 0, 10, "m")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Ground:
    """Heights of uneven ground in a frame."""

    #: (h, w) height of each pixel above the ground under it, NaN if unknown
    height_m: NDArray[np.float32]
    #: height in the world of the middle of the visible ground
    middle_z_m: float


_UPWARD = 0.8
_LEAST_PX = 3
# The ground under an object is interpolated from the cells around it, up to this many cells away.
_FILLED_CELLS = 4


def uneven_ground(
    surface: Surface,
    known: NDArray[np.bool_],
    floor_z_m: float | None,
    config: GroundConfig,
    *,
    below_camera_m: float,
    least_m2: float,
) -> Ground | None:
    """Return the ground of a frame if it is uneven; None if it is one level plane.

    `known` (h, w): pixels in structure voxels of the map; `floor_z_m`: height of the floor as one plane, if known;
    `below_camera_m`: minimum distance of ground below the camera; `least_m2`: minimum area of a region of ground.
    """
    camera_z = float(surface.world_from_camera[2, 3])
    grid = _heights_of(surface, known, camera_z - below_camera_m)
    if grid is None:
        return None
    regions = _regions(grid.z_m, grid.slack_m, np.float32(_CELL_M * config.slope))
    is_ground = _is_ground(regions, grid, floor_z_m, config, least_m2)
    if not is_ground.any():
        return None
    heights = grid.z_m[is_ground]
    off_m = np.abs(heights - np.float32(np.median(heights) if floor_z_m is None else floor_z_m))
    off = int((off_m > _OFF_PLANE_M + grid.slack_m[is_ground]).sum())
    if off * _CELL_M * _CELL_M < _OFF_PLANE_M2:
        return None
    filled = _filled(np.where(is_ground, grid.z_m, np.float32(np.nan)), _FILLED_CELLS)
    # A point may be in any cell within two sigmas of it.
    spread = np.float32(2 / _CELL_M) * surface.sigma_m
    cell, step = np.float32(_CELL_M), np.float32(_OFF_PLANE_M)
    height = _above(surface.points_world, spread, filled, _tops(filled, step), grid.low_m, cell, step)
    return Ground(height_m=height, middle_z_m=float(np.median(heights)))


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    # The lowest upward-facing surface of each cell (nx, ny): height (NaN if none), noise, share known as structure;
    # `low_m` (2,) is the corner of the first cell.
    z_m: NDArray[np.float32]
    slack_m: NDArray[np.float32]
    known: NDArray[np.float32]
    low_m: NDArray[np.float32]


def _heights_of(surface: Surface, known: NDArray[np.bool_], highest_m: float) -> _Grid | None:
    upward = (surface.normals_world[..., 2] > _UPWARD) & (surface.points_world[..., 2] < np.float32(highest_m))
    own, cell = np.flatnonzero(upward), np.float32(_CELL_M)
    if not len(own):
        return None
    points = surface.points_world.reshape(-1, 3).take(own, axis=0)
    bounds = bounds_of(points)[:, :2]
    low = np.floor(bounds[0] / cell) * cell
    size = tuple(int(n) for n in np.floor((bounds[1] - low) / cell) + 1)
    # Depth noise is along the ray: its vertical part is in proportion to the vertical component of the ray.
    eye = surface.world_from_camera[:3, 3].astype(np.float32)
    sigma, is_known = surface.sigma_m.ravel()[own], known.ravel()[own]
    z, slack, share = _lowest(points, sigma, is_known, eye, low, size[0], size[1], cell)
    return _Grid(z, slack, share, low)


@kernel
def _lowest(points, sigma, known, eye, low, size_x, size_y, cell_m):
    # The mean height (nx, ny) of the lowest layer of points in each cell, its noise, and its known share.
    cell, noise = np.empty(len(points), np.int64), np.empty(len(points), np.float32)
    least = np.full(size_x * size_y, np.float32(np.inf), np.float32)
    count, sums = np.zeros(len(least), np.int64), np.zeros((3, len(least)))
    for i in range(len(points)):
        x, y, z = points[i, 0] - eye[0], points[i, 1] - eye[1], points[i, 2] - eye[2]
        noise[i] = sigma[i] * abs(z) / np.sqrt(x * x + y * y + z * z)
        column, row = np.int64((points[i, 0] - low[0]) / cell_m), np.int64((points[i, 1] - low[1]) / cell_m)
        cell[i] = min(max(column, 0), size_x - 1) * size_y + min(max(row, 0), size_y - 1)
        least[cell[i]] = min(least[cell[i]], points[i, 2] + noise[i])
    for i in range(len(points)):
        at = cell[i]
        if points[i, 2] < least[at] + np.float32(0.04) + noise[i]:
            count[at] += 1
            sums[0, at] += points[i, 2]
            sums[1, at] += noise[i]
            sums[2, at] += 1.0 if known[i] else 0.0
    out = np.zeros((3, size_x, size_y), np.float32)
    for i in range(len(least)):
        for k in range(3):
            none = np.nan if k == 0 else 0.0
            out[k, i // size_y, i % size_y] = sums[k, i] / count[i] if count[i] >= _LEAST_PX else none
    return out[0], out[1], out[2]


@kernel
def _regions(z, slack, rise):
    # (nx, ny) the region of each cell, from 1 (0: no height): connected cells within the slope limit.
    size_x, size_y = z.shape
    regions, waiting, count = np.zeros((size_x, size_y), np.int32), np.empty((z.size, 2), np.int64), 0
    for first in range(z.size):
        x, y = first // size_y, first % size_y
        if regions[x, y] or np.isnan(z[x, y]):
            continue
        count += 1
        regions[x, y], waiting[0, 0], waiting[0, 1], num_waiting = count, x, y, 1
        while num_waiting:
            num_waiting -= 1
            x, y = waiting[num_waiting]
            for i in range(max(x - 1, 0), min(x + 2, size_x)):
                for j in range(max(y - 1, 0), min(y + 2, size_y)):
                    limit = rise if i == x or j == y else np.float32(1.4142) * rise
                    if not regions[i, j] and abs(z[x, y] - z[i, j]) <= limit + min(slack[x, y], slack[i, j]):
                        regions[i, j], waiting[num_waiting, 0], waiting[num_waiting, 1] = count, i, j
                        num_waiting += 1
    return regions


def _is_ground(
    regions: NDArray[np.int32], grid: _Grid, floor_z_m: float | None, config: GroundConfig, least_m2: float
) -> NDArray[np.bool_]:
    # (nx, ny) which cells are ground: regions of the floor, and regions one step away from ground.
    cells = np.bincount(regions.ravel())
    cells[0] = 0
    large = np.flatnonzero(cells * _CELL_M * _CELL_M >= least_m2)
    ground = _first_regions(regions, grid, floor_z_m, large)
    # A region on known structure one step away was ground in earlier keyframes: it needs no minimum area in this one.
    before = _known_regions(regions, grid, cells)
    left = sorted(({int(i) for i in large} | before) - ground)
    is_ground = np.isin(regions, sorted(ground))
    while left and ground:
        found = [i for i in left if _is_a_step_away(regions == i, is_ground, i in before, grid, config)]
        if not found:
            break
        ground.update(found)
        is_ground |= np.isin(regions, found)
        left = [i for i in left if i not in found]
    return is_ground


# Minimum shares of a region that is structure in the map (to start from it; to know it surely as ground), and how many
# cells of it must be at the height of the floor.
_KNOWN_SHARE, _SURELY_KNOWN = 0.25, 0.6
# A level within this distance of the map's floor is that floor.
AT_FLOOR_M = 0.06
_AT_FLOOR_CELLS = 3


def _known_regions(regions: NDArray[np.int32], grid: _Grid, cells: NDArray[np.int64]) -> set[int]:
    known = np.bincount(regions.ravel(), weights=grid.known.ravel(), minlength=len(cells))
    return {int(i) for i in np.flatnonzero((cells >= _AT_FLOOR_CELLS) & (known >= _SURELY_KNOWN * cells))} - {0}


def _first_regions(
    regions: NDArray[np.int32], grid: _Grid, floor_z_m: float | None, large: NDArray[np.int64]
) -> set[int]:
    # The large regions at the height of the floor; if there are none, the lowest one on known structure.
    if len(large) == 0:
        return set()
    if floor_z_m is not None:
        near = np.abs(grid.z_m - np.float32(floor_z_m)) < AT_FLOOR_M + grid.slack_m
        at_floor = [int(i) for i in large if int((near & (regions == i)).sum()) >= _AT_FLOOR_CELLS]
        if at_floor:
            return set(at_floor)
    known = [int(i) for i in large if float(grid.known[regions == i].mean()) >= _KNOWN_SHARE]
    some = known or ([] if floor_z_m is not None else [int(i) for i in large])
    if not some:
        return set()
    return {min(some, key=lambda i: (float(np.median(grid.z_m[regions == i])), i))}


def _is_a_step_away(
    region: NDArray[np.bool_], ground: NDArray[np.bool_], was_ground: bool, grid: _Grid, config: GroundConfig
) -> bool:
    # At most a step above, or two below, ground that is near; a higher level must be large, or known before.
    at, there = np.argwhere(region), np.argwhere(ground)
    rise_m, gap_m = _nearest_step(at, there, grid.z_m, np.float32(_CELL_M))
    if not gap_m <= _GAP_M:
        return False
    most_m = config.step_m + 0.1 * gap_m
    # A lower region is ground whatever its area, if it is at most two steps below.
    has_room = len(at) * _CELL_M * _CELL_M >= _LEVEL_M2
    return bool(-2 * most_m <= rise_m <= most_m and (rise_m < 0 or was_ground or has_room))


@kernel
def _nearest_step(at, there, z, cell):
    nearest = np.float32(np.inf)
    for i in range(len(at)):
        for j in range(len(there)):
            da, db = at[i, 0] - there[j, 0], at[i, 1] - there[j, 1]
            nearest = min(nearest, np.float32(da * da + db * db))
    total, count = 0.0, 0
    for i in range(len(at)):
        for j in range(len(there)):
            da, db = at[i, 0] - there[j, 0], at[i, 1] - there[j, 1]
            if da * da + db * db <= nearest + np.float32(2.0):
                total += z[at[i, 0], at[i, 1]] - z[there[j, 0], there[j, 1]]
                count += 1
    return total / max(count, 1), np.sqrt(nearest) * cell


@kernel
def _filled(z, steps):
    # Heights (nx, ny) with unknown cells filled by the mean of their known neighbours, `steps` times.
    out = z.copy()
    for _ in range(steps):
        before = out.copy()
        for a in range(z.shape[0]):
            for b in range(z.shape[1]):
                if not np.isnan(before[a, b]):
                    continue
                total, count = np.float32(0.0), 0
                for k in range(max(a - 1, 0), min(a + 2, z.shape[0])):
                    for m in range(max(b - 1, 0), min(b + 2, z.shape[1])):
                        if not np.isnan(before[k, m]):
                            total += before[k, m]
                            count += 1
                if count >= 2:
                    out[a, b] = total / np.float32(count)
    return out


@kernel
def _tops(z, step):
    # (nx, ny) the highest of the nine cells around each, where they hold a step; else minus infinity.
    out = np.full(z.shape, np.float32(-np.inf), dtype=np.float32)
    for a in range(z.shape[0]):
        for b in range(z.shape[1]):
            least, most = np.float32(np.inf), np.float32(-np.inf)
            for k in range(max(a - 1, 0), min(a + 2, z.shape[0])):
                for m in range(max(b - 1, 0), min(b + 2, z.shape[1])):
                    if not np.isnan(z[k, m]):
                        least, most = min(least, z[k, m]), max(most, z[k, m])
            # The slope itself rises over three cells by one and a half times its rise over two.
            if most - least > np.float32(1.5) * step:
                out[a, b] = most
    return out


@kernel
def _above(points, spread, z, tops, low, cell, step):
    # At the edge of a step the higher level counts, also in a cell with both: the face of a kerb is ground.
    height, width, _ = points.shape
    nx, ny = z.shape
    out = np.full((height, width), np.float32(np.nan), dtype=np.float32)
    half = np.float32(0.5)
    for y in range(height):
        for x in range(width):
            if np.isnan(points[y, x, 2]):
                continue
            fx, fy = (points[y, x, 0] - low[0]) / cell - half, (points[y, x, 1] - low[1]) / cell - half
            a, b = int(np.floor(fx)), int(np.floor(fy))
            u, v = fx - np.float32(a), fy - np.float32(b)
            total, weight = np.float32(0.0), np.float32(0.0)
            least, most = np.float32(np.inf), np.float32(-np.inf)
            for k in range(2):
                for m in range(2):
                    if a + k < 0 or b + m < 0 or a + k >= nx or b + m >= ny or np.isnan(z[a + k, b + m]):
                        continue
                    here = z[a + k, b + m]
                    share = (u if k else np.float32(1.0) - u) * (v if m else np.float32(1.0) - v)
                    total += share * here
                    weight += share
                    least, most = min(least, here), max(most, here)
            if weight <= 0:
                continue
            ground = most if most - least > step else total / weight
            i, j, reach = fx + half, fy + half, spread[y, x]
            for k in range(max(int(np.floor(i - reach)), 0), min(int(np.floor(i + reach)) + 1, nx)):
                for m in range(max(int(np.floor(j - reach)), 0), min(int(np.floor(j + reach)) + 1, ny)):
                    ground = max(ground, tops[k, m])
            out[y, x] = points[y, x, 2] - ground
    return out
