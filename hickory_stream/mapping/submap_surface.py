"""The surface of a submap: mean points of voxels, thinned out; what loops are searched in and refined on.

It is made of the low-resolution depth that the journal keeps of each keyframe, so that a run that is resumed has it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import contains, inserted, keys_of_points, places

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import CoarseFrame

_NEAREST_M = 0.2
_MOST_HITS = 255


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SubmapSurface:
    """Sorted voxel `keys` (N,), mean `points` (N, 3) in the odometry's frame, and `hits` (N,): keyframes per voxel."""

    keys: NDArray[np.int64]
    points: NDArray[np.float32]
    hits: NDArray[np.uint8]

    def __post_init__(self) -> None:
        freeze(self, "keys", np.int64, (None,))
        freeze(self, "points", np.float32, (len(self.keys), 3))
        freeze(self, "hits", np.uint8, (len(self.keys),))

    def __len__(self) -> int:
        return len(self.keys)


def no_surface() -> SubmapSurface:
    """Return an empty surface."""
    return SubmapSurface(keys=np.empty(0, np.int64), points=np.empty((0, 3), np.float32), hits=np.empty(0, np.uint8))


def with_points(surface: SubmapSurface, points: NDArray[np.float32], voxel_m: float) -> SubmapSurface:
    """Return the surface with one keyframe's points (N, 3): each voxel's mean is that of the means of keyframes."""
    seen_keys, seen = _voxel_means(points, voxel_m)
    is_known = contains(surface.keys, seen_keys)
    new_keys = seen_keys[~is_known]
    at = np.searchsorted(surface.keys, new_keys)
    keys = inserted(surface.keys, at, new_keys)
    means, hits = np.empty((len(keys), 3), np.float32), inserted(surface.hits, at, np.ones(len(new_keys), np.uint8))
    for axis in range(3):
        means[:, axis] = inserted(np.ascontiguousarray(surface.points[:, axis]), at, seen[~is_known, axis])
    again = places(keys, seen_keys[is_known])
    weight = hits[again].astype(np.float32)[:, None]
    means[again] = (means[again] * weight + seen[is_known]) / (weight + np.float32(1.0))
    hits[again] = np.minimum(hits[again].astype(np.int64) + 1, _MOST_HITS).astype(np.uint8)
    return SubmapSurface(keys=keys, points=means, hits=hits)


def points_of(coarse: CoarseFrame, world_from_camera: NDArray[np.float64], range_m: float) -> NDArray[np.float32]:
    """Return the points (N, 3), in the odometry's frame, of a keyframe's low-resolution depth up to a range.

    None are returned for keyframes of older journals, which do not have their camera.
    """
    camera = coarse.camera
    if camera is None:
        return np.empty((0, 3), dtype=np.float32)
    left, top = (min(coarse.stride_px // 2, side - 1) for side in (camera.width, camera.height))
    depth = coarse.depth_mm / np.float32(1000.0)
    rows, columns = np.nonzero((depth > _NEAREST_M) & (depth < range_m))
    z = depth[rows, columns].astype(np.float64)
    x = (columns * coarse.stride_px + left - camera.cx) / camera.fx * z
    y = (rows * coarse.stride_px + top - camera.cy) / camera.fy * z
    return np.asarray(apply(world_from_camera, np.column_stack([x, y, z])), dtype=np.float32)


def _voxel_means(points: NDArray[np.float32], voxel_m: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    keys = keys_of_points(points, voxel_m)
    order = np.argsort(keys, kind="stable")
    unique, starts = np.unique(keys[order], return_index=True)
    if len(unique) == 0:
        return unique, np.empty((0, 3), np.float32)
    counts = np.diff(np.append(starts, len(keys)))[:, None]
    sums = np.add.reduceat(points[order].astype(np.float64), starts)
    return unique, (sums / counts).astype(np.float32)
