"""Space observed by a keyframe: the free voxels that its rays traverse, and the voxels on structure.

Planning and the removal of false objects rely on it, so a ray stops one voxel before its return, and pixels without a
return are ignored.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.camera import backproject, whole_reduction
from hickory_stream.geometry.lattice import Lattice
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import difference, keys_of_cells, keys_of_points, sorted_unique
from hickory_stream.perception.coarse import sampled_camera, sampled_pixels
from hickory_stream.records import Frame, Segmentation, SpaceObservation

# A return whose depth has a larger standard deviation than this many voxels is ignored.
_MOST_SIGMA = 1.25


@dataclass(frozen=True, kw_only=True, slots=True)
class SpaceConfig(Ranged):
    """The sampling of rays."""

    #: Stride of the rays in both directions, in pixels of an image of 640 columns.
    stride_px: int = number(6, 1, 1000, "px")


def observe_space(
    frame: Frame,
    segmentation: Segmentation,
    config: SpaceConfig,
    lattice: Lattice,
    free_keys: NDArray[np.int64] | None = None,
) -> SpaceObservation:
    """Return the free and structure voxels of a frame; `free_keys`: the result of `free_space`, if it was called."""
    points, valid, pixels = _rays(frame, config, _reach_m(frame, lattice))
    structure = segmentation.own_structure[pixels][valid]
    on_structure = sorted_unique(keys_of_points(points[structure], lattice.space_m))
    return SpaceObservation(
        free_keys=free_space(frame, config, lattice) if free_keys is None else free_keys,
        structure_keys=on_structure,
        surface_keys=difference(sorted_unique(keys_of_points(points[~structure], lattice.space_m)), on_structure),
        floor_z_m=segmentation.floor_z_m,
    )


def free_space(frame: Frame, config: SpaceConfig, lattice: Lattice) -> NDArray[np.int64]:
    """Return the sorted keys of the free voxels of a frame; structure does not matter."""
    reach_m = _reach_m(frame, lattice)
    points, _, _ = _rays(frame, config, reach_m)
    origin = frame.world_from_camera[:3, 3].astype(np.float64)
    return _free_keys(origin, points, _dense_returns(frame, config, reach_m), lattice.space_m)


def _reach_m(frame: Frame, lattice: Lattice) -> float:
    return frame.sensor.reach_m(_MOST_SIGMA * lattice.space_m)


def _stride_of(frame: Frame, config: SpaceConfig) -> int:
    return config.stride_px * whole_reduction(frame.camera.width)


def _rays(
    frame: Frame, config: SpaceConfig, reach_m: float
) -> tuple[NDArray[np.float64], NDArray[np.bool_], tuple[slice, slice]]:
    # (N, 3) where the rays end in the world, (h, w) which of them have an end, and their pixels (h, w).
    stride = _stride_of(frame, config)
    pixels = sampled_pixels(frame.depth_m.shape, stride)
    depth, camera = frame.depth_m[pixels], sampled_camera(frame.camera, stride)
    valid = np.isfinite(depth) & (depth < reach_m)
    points = apply(frame.world_from_camera, backproject(depth, camera)[valid]).astype(np.float64)
    return points, valid, pixels


def _dense_returns(frame: Frame, config: SpaceConfig, reach_m: float) -> NDArray[np.float64]:
    # At half the stride: rays beside a pole must not free its voxels.
    step = max(1, _stride_of(frame, config) // 2)
    camera = frame.camera
    points = _returns(frame.depth_m, step, camera.fx, camera.fy, camera.cx, camera.cy, reach_m)
    return apply(frame.world_from_camera, points)


@kernel
def _returns(depth, step, fx, fy, cx, cy, farthest):
    # (N, 3) the returns of every `step`-th pixel in the camera's frame.
    height, width = depth.shape
    out = np.empty((-(-height // step) * -(-width // step), 3))
    count = 0
    for y in range(0, height, step):
        for x in range(0, width, step):
            if np.isfinite(depth[y, x]) and depth[y, x] < farthest:
                z = np.float64(depth[y, x])
                out[count, 0], out[count, 1], out[count, 2] = (x - cx) / fx * z, (y - cy) / fy * z, z
                count += 1
    return out[:count]


def _free_keys(
    origin: NDArray[np.float64], ends: NDArray[np.float64], returns: NDArray[np.float64], voxel_m: float
) -> NDArray[np.int64]:
    # Rays to (N, 3) ends stop one voxel before; voxels with a return stay. One bit per voxel of the box around all
    # rays.
    if len(ends) == 0:
        return np.empty(0, dtype=np.int64)
    # A margin of one voxel on each side, for rounding in a ray's last step.
    lowest, highest = bounds_of(ends)
    low = np.floor(np.minimum(lowest, origin) / voxel_m).astype(np.int64) - 1
    high = np.floor(np.maximum(highest, origin) / voxel_m).astype(np.int64) + 1
    sides = high - low + 1
    sides[2] = -(-sides[2] // 64) * 64  # a column of voxels fills whole words
    words = np.zeros(int(sides.prod()) // 64, dtype=np.uint64)
    _mark_crossed(words, low, sides, origin, ends, voxel_m)
    _unmark(words, low, sides, returns, voxel_m)
    keys: NDArray[np.int64] = _marked_keys(words, int(keys_of_cells(low[None])[0]), sides, _STEP_X, _STEP_Y)
    return keys


# How much the key of a voxel changes from one to the next along x, and along y.
_STEP_X, _STEP_Y, _ = (int(step) for step in keys_of_cells(np.eye(3)) - keys_of_cells(np.zeros((3, 3))))


@kernel
def _mark_crossed(words, low, sides, origin, ends, voxel):
    # Coordinates are in voxels; the step along a ray is 0.7 voxels.
    start_x, start_y, start_z = origin[0] / voxel, origin[1] / voxel, origin[2] / voxel
    longest = 0
    for i in range(3):
        longest += sides[i]
    places = np.empty(2 * longest, dtype=np.int64)
    for i in range(len(ends)):
        ray_x, ray_y, ray_z = ends[i, 0] - origin[0], ends[i, 1] - origin[1], ends[i, 2] - origin[2]
        length = np.sqrt(ray_x * ray_x + ray_y * ray_y + ray_z * ray_z)
        steps = int((length - voxel) / (0.7 * voxel))
        if steps < 2:
            continue
        step_x, step_y, step_z = 0.7 * ray_x / length, 0.7 * ray_y / length, 0.7 * ray_z / length
        # Two loops, so that the first, arithmetic alone, is vectorised.
        for k in range(1, steps):
            x = np.int64(np.floor(start_x + k * step_x)) - low[0]
            y = np.int64(np.floor(start_y + k * step_y)) - low[1]
            z = np.int64(np.floor(start_z + k * step_z)) - low[2]
            places[k] = (x * sides[1] + y) * sides[2] + z
        for k in range(1, steps):
            words[places[k] >> 6] |= np.uint64(1) << np.uint64(places[k] & 63)


@kernel
def _unmark(words, low, sides, points, voxel):
    for i in range(len(points)):
        x = np.int64(np.floor(points[i, 0] / voxel)) - low[0]
        y = np.int64(np.floor(points[i, 1] / voxel)) - low[1]
        z = np.int64(np.floor(points[i, 2] / voxel)) - low[2]
        if 0 <= x < sides[0] and 0 <= y < sides[1] and 0 <= z < sides[2]:
            place = (x * sides[1] + y) * sides[2] + z
            words[place >> 6] &= ~(np.uint64(1) << np.uint64(place & 63))


@kernel
def _marked_keys(words, lowest, sides, step_x, step_y):
    count = 0
    for word in words:
        while word:
            word &= word - np.uint64(1)
            count += 1
    keys = np.empty(count, dtype=np.int64)
    n = 0
    per_column = sides[2] // 64
    for i in range(len(words)):
        word = words[i]
        if word == 0:
            continue
        column = i // per_column
        first = lowest + column // sides[1] * step_x + column % sides[1] * step_y + 64 * (i % per_column)
        bit = 0
        while word:
            if word & np.uint64(1):
                keys[n] = first + bit
                n += 1
            word >>= np.uint64(1)
            bit += 1
    return keys
