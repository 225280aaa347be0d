"""What a keyframe says of space: the voxels its rays passed through, and those on structure.

Planning, visibility checks and the dissolving of phantoms rest on it, so it errs towards unknown: a ray stops one voxel
before its return, and a pixel without a return says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from hickory_stream.geometry.camera import Camera, backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import contains, keys_of_cells, keys_of_points
from hickory_stream.records import SpaceObservation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Frame, Segmentation


@dataclass(frozen=True, kw_only=True, slots=True)
class SpaceConfig:
    """The grid and the sampling of rays.

    Attributes:
        voxel_m: side of a cell.
        stride_px: every so many pixels a ray, in both directions.
        max_depth_m: farther returns are ignored.
    """

    voxel_m: float = 0.05
    stride_px: int = 6
    max_depth_m: float = 5.0


def observe_space(frame: Frame, segmentation: Segmentation, config: SpaceConfig) -> SpaceObservation:
    """Return the free and structure voxels of a frame."""
    stride = config.stride_px
    # The middle of each cell; an image that is smaller than one still has a ray.
    top, left = min(stride // 2, frame.camera.height - 1), min(stride // 2, frame.camera.width - 1)
    depth = frame.depth_m[top::stride, left::stride]
    structure = segmentation.structure[top::stride, left::stride]
    camera = Camera(
        width=depth.shape[1],
        height=depth.shape[0],
        fx=frame.camera.fx / stride,
        fy=frame.camera.fy / stride,
        cx=(frame.camera.cx - left) / stride,
        cy=(frame.camera.cy - top) / stride,
    )
    valid = np.isfinite(depth) & (depth < config.max_depth_m)
    points = apply(frame.world_from_camera, backproject(depth, camera)[valid]).astype(np.float64)
    cells = _free_cells(frame.world_from_camera[:3, 3].astype(np.float64), points, config.voxel_m)
    structure_keys = _sorted_unique(keys_of_points(points[structure[valid]], config.voxel_m))
    free_keys = _sorted_unique(keys_of_cells(cells))
    return SpaceObservation(
        free_keys=free_keys[~contains(_occupied_keys(frame, config), free_keys)],
        structure_keys=structure_keys,
        floor_z_m=segmentation.floor_z_m,
    )


def _occupied_keys(frame: Frame, config: SpaceConfig) -> NDArray[np.int64]:
    """Return the voxels with a return in them, sampled twice as densely: a pole is not free for the rays beside it."""
    step = max(1, config.stride_px // 2)
    camera = frame.camera
    depth = frame.depth_m[::step, ::step]
    v, u = np.nonzero(np.isfinite(depth) & (depth < config.max_depth_m))
    z = depth[v, u].astype(np.float64)
    points = np.stack([(u * step - camera.cx) / camera.fx * z, (v * step - camera.cy) / camera.fy * z, z], axis=1)
    return _sorted_unique(keys_of_points(apply(frame.world_from_camera, points), config.voxel_m))


def _sorted_unique(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what np.unique does; a sort of integers takes a fraction of the time of its hash table."""
    ordered = np.sort(keys)
    return ordered[np.flatnonzero(np.diff(ordered, prepend=ordered[:1] - 1))]


@numba.njit(cache=True, nogil=True)
def _free_cells(origin, points, voxel):  # type: ignore[no-untyped-def] # pragma: no cover
    """Collect the cells that rays cross, each once per stretch of rays, up to one voxel before the return."""
    capacity = 4096
    cells = np.empty((capacity, 3), dtype=np.int64)
    count = 0
    # A small direct-mapped cache drops most repetitions: neighbouring rays cross the same cells.
    cache = np.full(1 << 15, np.int64(-(1 << 62)), dtype=np.int64)
    # In units of a voxel, stepping 0.7 of one along the ray.
    start_x, start_y, start_z = origin[0] / voxel, origin[1] / voxel, origin[2] / voxel
    for i in range(len(points)):
        ray_x, ray_y, ray_z = points[i, 0] - origin[0], points[i, 1] - origin[1], points[i, 2] - origin[2]
        length = np.sqrt(ray_x * ray_x + ray_y * ray_y + ray_z * ray_z)
        steps = int((length - voxel) / (0.7 * voxel))
        if steps < 2:
            continue
        step_x, step_y, step_z = 0.7 * ray_x / length, 0.7 * ray_y / length, 0.7 * ray_z / length
        for k in range(1, steps):
            x = np.int64(np.floor(start_x + k * step_x))
            y = np.int64(np.floor(start_y + k * step_y))
            z = np.int64(np.floor(start_z + k * step_z))
            key = (x * 73856093) ^ (y * 19349663) ^ (z * 83492791)
            packed = (x & 0x1FFFFF) << 42 | (y & 0x1FFFFF) << 21 | (z & 0x1FFFFF)
            slot = key & 0x7FFF
            if cache[slot] == packed:
                continue
            cache[slot] = packed
            if count == capacity:
                capacity *= 2
                grown = np.empty((capacity, 3), dtype=np.int64)
                grown[:count] = cells
                cells = grown
            cells[count, 0], cells[count, 1], cells[count, 2] = x, y, z
            count += 1
    return cells[:count]
