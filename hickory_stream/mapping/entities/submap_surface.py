"""The surface of a submap, in which loops are searched: mean points and normals of voxels.

It is made of the low-resolution depth that the journal keeps of each keyframe, so a resumed run has it. Normals look at
the camera: the two sides of a wall are never confused.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.lazy_arrays import GivesUpArrays
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import groups_of, keys_of_points
from hickory_stream.records import CoarseFrame

_NEAREST_M = 0.2
_MOST_HITS = 255
_STEP_CELLS = 2
# A greater change of depth, as a share, between cells two apart is an edge, not a surface.
_MAX_SLOPE = 0.15

# A surface seen at a more grazing angle has no certain normal.
_LEAST_COSINE = 0.15


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SurfacePoints:
    """Points (N, 3) on surfaces, and their unit `normals` (N, 3) on the side of the camera."""

    points: NDArray[np.float32]
    normals: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False, weakref_slot=True)
class SubmapSurface(GivesUpArrays):
    """Sorted voxel `keys` (N,), mean `points` and `normals` (N, 3) in the odometry's frame, and `hits` (N,): keyframes.

    A mean normal is shorter the more the normals differ: near 0 where one voxel holds both sides of a board.
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
    """Return the surface with one keyframe's points: each voxel holds the mean of the keyframes' means."""
    seen_keys, means = _voxel_means(seen, voxel_m)
    keys, points, normals, hits = _with_means(
        surface.keys, surface.points, surface.normals, surface.hits, seen_keys, means
    )
    for made in (keys, points, normals, hits):
        made.flags.writeable = False  # nobody else has them: they need not be copied
    return SubmapSurface(keys=keys, points=points, normals=normals, hits=hits)


@kernel
def _with_means(keys, points, normals, hits, seen_keys, means):
    most = len(keys) + len(seen_keys)
    out_keys, out_hits = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.uint8)
    out_points, out_normals = np.empty((most, 3), dtype=np.float32), np.empty((most, 3), dtype=np.float32)
    i, j, n = 0, 0, 0
    while i < len(keys) or j < len(seen_keys):
        is_known = i < len(keys) and (j == len(seen_keys) or keys[i] <= seen_keys[j])
        is_seen = j < len(seen_keys) and (i == len(keys) or seen_keys[j] <= keys[i])
        out_keys[n] = keys[i] if is_known else seen_keys[j]
        out_hits[n] = hits[i] if is_known else 1
        weight = np.float32(hits[i]) if is_known else np.float32(0.0)
        for k in range(3):
            if is_known and is_seen:
                point = (points[i, k] * weight + means[j, k]) / (weight + np.float32(1.0))
                normal = (normals[i, k] * weight + means[j, 3 + k]) / (weight + np.float32(1.0))
            elif is_known:
                point, normal = points[i, k], normals[i, k]
            else:
                point, normal = means[j, k], means[j, 3 + k]
            out_points[n, k], out_normals[n, k] = point, normal
        if is_known and is_seen and hits[i] < _MOST_HITS:
            out_hits[n] += 1
        i += is_known
        j += is_seen
        n += 1
    return out_keys[:n].copy(), out_points[:n].copy(), out_normals[:n].copy(), out_hits[:n].copy()


def surface_points(coarse: CoarseFrame, world_from_camera: NDArray[np.float64], range_m: float) -> SurfacePoints:
    """Return the surfaces of a keyframe's low-resolution depth up to a range, in the odometry's frame.

    A normal comes from the triangle of a cell and the cells two to the right and two below; a point without one is left
    out.
    """
    camera = coarse.camera
    left, top = (min(coarse.stride_px // 2, side - 1) for side in (camera.width, camera.height))
    here, unit = _facets(
        coarse.depth_mm,
        (coarse.stride_px, left, top),
        (float(camera.fx), float(camera.fy), float(camera.cx), float(camera.cy)),
        float(range_m),
    )
    return SurfacePoints(
        points=np.asarray(apply(world_from_camera, here), dtype=np.float32),
        normals=np.asarray(portable.matmul(unit, world_from_camera[:3, :3].T), dtype=np.float32),
    )


@kernel(error_model="numpy")
def _facets(depth_mm, cells, lens, range_m):
    # (N, 3) points and unit normals in the camera; `cells`: their stride, and the pixel of the first.
    (stride, left, top), (fx, fy, cx, cy) = cells, lens
    height, width = depth_mm.shape
    places = np.empty((height, width, 3))
    for row in range(height):
        for column in range(width):
            z = depth_mm[row, column] / 1000.0
            places[row, column, 0] = (column * stride + left - cx) / fx * z
            places[row, column, 1] = (row * stride + top - cy) / fy * z
            places[row, column, 2] = z
    step = _STEP_CELLS
    points, normals = np.empty((height * width, 3)), np.empty((height * width, 3))
    n = 0
    for row in range(height - step):
        for column in range(width - step):
            x, y, z = places[row, column, 0], places[row, column, 1], places[row, column, 2]
            right, below = places[row, column + step], places[row + step, column]
            if not (abs(right[2] - z) < _MAX_SLOPE * z and abs(below[2] - z) < _MAX_SLOPE * z):
                continue
            if not (z > _NEAREST_M and z < range_m):
                continue
            ax, ay, az = below[0] - x, below[1] - y, below[2] - z
            bx, by, bz = right[0] - x, right[1] - y, right[2] - z
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            distance = np.sqrt(x * x + y * y + z * z)
            if not -(nx * x + ny * y + nz * z) / (length * distance) > _LEAST_COSINE:
                continue
            points[n, 0], points[n, 1], points[n, 2] = x, y, z
            normals[n, 0], normals[n, 1], normals[n, 2] = nx / length, ny / length, nz / length
            n += 1
    return points[:n].copy(), normals[:n].copy()


def _voxel_means(seen: SurfacePoints, voxel_m: float) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    groups, keys = groups_of(keys_of_points(seen.points, voxel_m))
    if len(keys) == 0:
        return keys, np.empty((0, 6), np.float32)
    by_key = np.argsort(keys, kind="stable")
    values, starts = _by_group(groups, by_key, seen.points, seen.normals)
    counts = np.diff(np.append(starts, len(values)))[:, None]
    return keys[by_key], (np.add.reduceat(values, starts) / counts).astype(np.float32)


@kernel
def _by_group(groups, by_key, points, normals):
    counts = np.zeros(len(by_key), dtype=np.int64)
    for i in range(len(groups)):
        counts[groups[i]] += 1
    starts, next_places = np.empty(len(by_key), dtype=np.int64), np.empty(len(by_key), dtype=np.int64)
    total = 0
    for rank in range(len(by_key)):
        starts[rank] = next_places[by_key[rank]] = total
        total += counts[by_key[rank]]
    values = np.empty((len(groups), 6))
    for i in range(len(groups)):
        place = next_places[groups[i]]
        next_places[groups[i]] += 1
        for k in range(3):
            values[place, k], values[place, 3 + k] = points[i, k], normals[i, k]
    return values, starts
