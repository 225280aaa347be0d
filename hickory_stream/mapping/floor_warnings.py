"""Warnings about the floor of a map and about gravity.

The tilt comes from a plane fitted to the lowest structure voxel of each column near the floor's height, then to the
inliers again. Uneven ground has no tilt.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.voxels import cells_of_keys
from hickory_stream.mapping.entities.observed_space import WALL_M, column_sizes, column_starts, is_wall_column
from hickory_stream.records import MapSnapshot, ObservedSpace
from hickory_stream.storeys import floor_height_m, floors_of

# How far above and below the floor's height columns are searched: a tilt of 2 degrees is 0.35 m over 10 m.
_REACH_M = 0.45
# A tilt is reported only for a plane with inliers within this many voxels, of at least this size, over one degree.
_PLANE_VOXELS, _LEAST_M2, _LEAST_DEG = 0.8, 2.0, 1.0
# A smaller horizontal surface may be a table, if no larger floor was ever seen.
_TABLE_M2 = 2.0


def floor_warnings(snapshot: MapSnapshot) -> tuple[str, ...]:
    """Return the warnings about the floor of a map; none for one level floor."""
    floors = [submap for submap in snapshot.submaps if submap.observed_space.floor_z_m is not None]
    if not floors:
        if not any(len(submap.observed_space.free) for submap in snapshot.submaps):
            return ()
        return (
            "no floor was seen: heights above the floor are unknown. Decisions that need them (walls, unsupported "
            "objects, traversability) are not made, or use the height of the lowest object. If a floor was in view, "
            "check that the poses have z upwards",
        )
    notes = []
    areas_m2 = [_area_m2(submap.observed_space) for submap in floors]
    if sum(areas_m2) < _TABLE_M2:
        notes.append(
            f"the floor is uncertain: the surface taken for it, at z = {floor_height_m(floors[-1]):.2f} m, has an area "
            f"of {sum(areas_m2):.1f} m2 only and may be a table. A lower floor replaces it as soon as it is seen"
        )
    levels = floors_of(snapshot)
    if len(levels) > 1:
        heights = ", ".join(f"{z_m:.2f} m" for z_m in levels)
        notes.append(f"the floor has {len(levels)} levels, at z = {heights}: each submap uses its own")
    largest = max(floors, key=lambda submap: _area_m2(submap.observed_space))
    tilted = tilt_warning(largest.observed_space)
    return (*notes, tilted) if tilted is not None else tuple(notes)


def tilt_warning(space: ObservedSpace) -> str | None:
    """Return a warning about the tilt of the floor of a space; None if it is level or not a plane."""
    places, voxel_m = _columns(space, _REACH_M), space.voxel_m
    slope = _slope(places, voxel_m)
    if slope is None:
        return None
    rise, share = slope
    tilt_deg = float(np.degrees(portable.arctan2(portable.norm(rise), 1.0)))
    if len(places) * voxel_m * voxel_m < _LEAST_M2 or share < 0.7 or tilt_deg < _LEAST_DEG:
        return None
    uphill_deg = float(np.degrees(portable.arctan2(rise[1], rise[0])))
    return (
        f"the floor is tilted by {tilt_deg:.1f} degrees against gravity, uphill towards {uphill_deg:.0f} degrees from "
        "x: the ground slopes, or the poses are not aligned with gravity. The map uses the floor as it is; upright "
        "boxes are tilted against it by as much"
    )


def _area_m2(space: ObservedSpace) -> float:
    return len(_columns(space, 1.5 * space.voxel_m)) * space.voxel_m * space.voxel_m


def _columns(space: ObservedSpace, reach_m: float) -> NDArray[np.float64]:
    # (N, 3) the centres of the lowest structure voxels of columns near the floor, without walls.
    middles = (cells_of_keys(space.structure) + 0.5) * space.voxel_m
    above_m = middles[:, 2] - (space.floor_z_m or 0.0)
    near = middles[(above_m > -reach_m) & (above_m < reach_m + WALL_M)]
    starts = column_starts(near)
    lowest = near[starts]
    is_wall = is_wall_column(column_sizes(starts, len(near)), space.voxel_m)
    is_floor = ~is_wall & (lowest[:, 2] - (space.floor_z_m or 0.0) < reach_m)
    return np.asarray(lowest[is_floor], dtype=np.float64)


def _slope(places: NDArray[np.float64], voxel_m: float) -> tuple[NDArray[np.float64], float] | None:
    # The slope along x and y of a plane fitted to (N, 3) points, and its share of inliers; None if too few.
    rise, level, near = np.zeros(2), float(np.median(places[:, 2])) if len(places) else 0.0, np.ones(len(places), bool)
    middle = places[:, :2].mean(axis=0) if len(places) else np.zeros(2)
    for reach_m in (_REACH_M, 6 * voxel_m, 3 * voxel_m, 2 * voxel_m, 2 * voxel_m):
        flat = places[:, :2] - middle
        off_m = places[:, 2] - level - flat[:, 0] * rise[0] - flat[:, 1] * rise[1]
        near = np.abs(off_m) < reach_m
        if int(near.sum()) < 50:
            return None
        found = _fitted(flat[near], places[near, 2])
        if found is None:
            return None
        rise, level = found
    flat = places[:, :2] - middle
    off_m = places[:, 2] - level - flat[:, 0] * rise[0] - flat[:, 1] * rise[1]
    return rise, float((np.abs(off_m) < _PLANE_VOXELS * voxel_m).mean())


def _fitted(flat: NDArray[np.float64], z: NDArray[np.float64]) -> tuple[NDArray[np.float64], float] | None:
    # The least squares plane z = rise . (x, y) + level; None if the points are on one line.
    x, y = flat[:, 0] - flat[:, 0].mean(), flat[:, 1] - flat[:, 1].mean()
    h = z - z.mean()
    xx, xy, yy, xh, yh = (float((a * b).sum()) for a, b in ((x, x), (x, y), (y, y), (x, h), (y, h)))
    determinant = xx * yy - xy * xy
    if determinant < 1e-6 * (xx + yy) * (xx + yy):
        return None
    rise = np.array([(xh * yy - yh * xy) / determinant, (yh * xx - xh * xy) / determinant])
    return rise, float(z.mean() - rise[0] * flat[:, 0].mean() - rise[1] * flat[:, 1].mean())
