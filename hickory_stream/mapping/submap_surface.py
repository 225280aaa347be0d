"""The surface of a submap: mean points and normals of voxels; what loops are searched in and refined on.

It is made of the low-resolution depth that the journal keeps of each keyframe, so that a run that is resumed has it.
Normals look at the camera: a wall between two rooms has two sides, which are never taken for one another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.made_arrays import GivesUpArrays
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import contains, inserted, keys_of_points, places

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import CoarseFrame

_NEAREST_M = 0.2
_MOST_HITS = 255
_STEP_CELLS = 2
_MAX_SLOPE = 0.15
"""Where depth changes by more than this share from a cell to one two cells away there is an edge, not a surface."""

_LEAST_COSINE = 0.15
"""A surface that is seen at a more grazing angle has no certain normal."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SurfacePoints:
    """Points (N, 3) on surfaces, and the `normals` (N, 3) of these, unit, on the side of the camera."""

    points: NDArray[np.float32]
    normals: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class SubmapSurface(GivesUpArrays):
    """Sorted voxel `keys` (N,), mean `points` and `normals` (N, 3) in the odometry's frame, and `hits` (N,): keyframes.

    A mean of normals is shorter than 1 the more these differ: where both sides of a board are in one voxel, near 0.
    """

    keys: NDArray[np.int64]
    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    hits: NDArray[np.uint8]

    def __post_init__(self) -> None:
        freeze(self, "keys", np.int64, (None,))
        freeze(self, "points", np.float32, (len(self.keys), 3))
        freeze(self, "normals", np.float32, (len(self.keys), 3))
        freeze(self, "hits", np.uint8, (len(self.keys),))

    def __len__(self) -> int:
        return len(self.keys)


def no_surface() -> SubmapSurface:
    """Return an empty surface."""
    none = np.empty((0, 3), np.float32)
    return SubmapSurface(keys=np.empty(0, np.int64), points=none, normals=none, hits=np.empty(0, np.uint8))


def with_points(surface: SubmapSurface, seen: SurfacePoints, voxel_m: float) -> SubmapSurface:
    """Return the surface with one keyframe's points: each voxel's mean is that of the means of keyframes."""
    seen_keys, means = _voxel_means(seen, voxel_m)
    is_known = contains(surface.keys, seen_keys)
    new_keys = seen_keys[~is_known]
    at = np.searchsorted(surface.keys, new_keys)
    keys = inserted(surface.keys, at, new_keys)
    hits = inserted(surface.hits, at, np.ones(len(new_keys), np.uint8))
    known = np.concatenate([surface.points, surface.normals], axis=1)
    values = np.empty((len(keys), 6), np.float32)
    for column in range(6):
        values[:, column] = inserted(np.ascontiguousarray(known[:, column]), at, means[~is_known, column])
    again = places(keys, seen_keys[is_known])
    weight = hits[again].astype(np.float32)[:, None]
    values[again] = (values[again] * weight + means[is_known]) / (weight + np.float32(1.0))
    hits[again] = np.minimum(hits[again].astype(np.int64) + 1, _MOST_HITS).astype(np.uint8)
    return SubmapSurface(
        keys=keys, points=np.ascontiguousarray(values[:, :3]), normals=np.ascontiguousarray(values[:, 3:]), hits=hits
    )


def surface_points(coarse: CoarseFrame, world_from_camera: NDArray[np.float64], range_m: float) -> SurfacePoints:
    """Return the surfaces of a keyframe's low-resolution depth up to a range, in the odometry's frame.

    A normal is that of the triangle of a cell and those two to the right and two below; without one there is no point.
    None are returned for keyframes of older journals, which do not have their camera.
    """
    camera = coarse.camera
    if camera is None:
        none = np.empty((0, 3), dtype=np.float32)
        return SurfacePoints(points=none, normals=none)
    z = coarse.depth_mm / 1000.0
    rows, columns = np.indices(z.shape)
    left, top = (min(coarse.stride_px // 2, side - 1) for side in (camera.width, camera.height))
    x = (columns * coarse.stride_px + left - camera.cx) / camera.fx * z
    y = (rows * coarse.stride_px + top - camera.cy) / camera.fy * z
    places_camera = np.stack([x, y, z], axis=2)
    step = _STEP_CELLS
    here, right, below = places_camera[:-step, :-step], places_camera[:-step, step:], places_camera[step:, :-step]
    normals = np.cross(below - here, right - here)
    length = np.sqrt((normals * normals).sum(axis=2))
    distance = np.sqrt((here * here).sum(axis=2))
    with np.errstate(invalid="ignore", divide="ignore"):
        cosine = -(normals * here).sum(axis=2) / (length * distance)
        is_level = (np.abs(right[..., 2] - here[..., 2]) < _MAX_SLOPE * here[..., 2]) & (
            np.abs(below[..., 2] - here[..., 2]) < _MAX_SLOPE * here[..., 2]
        )
        is_surface = is_level & (here[..., 2] > _NEAREST_M) & (here[..., 2] < range_m) & (cosine > _LEAST_COSINE)
    unit = normals[is_surface] / length[is_surface][:, None]
    return SurfacePoints(
        points=np.asarray(apply(world_from_camera, here[is_surface]), dtype=np.float32),
        normals=np.asarray(portable.matmul(unit, world_from_camera[:3, :3].T), dtype=np.float32),
    )


def _voxel_means(seen: SurfacePoints, voxel_m: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Return the voxels of points, and the mean point and normal (M, 6) in each."""
    keys = keys_of_points(seen.points, voxel_m)
    order = np.argsort(keys, kind="stable")
    unique, starts = np.unique(keys[order], return_index=True)
    if len(unique) == 0:
        return unique, np.empty((0, 6), np.float32)
    counts = np.diff(np.append(starts, len(keys)))[:, None]
    values = np.concatenate([seen.points[order], seen.normals[order]], axis=1).astype(np.float64)
    return unique, (np.add.reduceat(values, starts) / counts).astype(np.float32)
