"""The 3D point that a pixel of a frame shows: from its mask, from recorded depth or structure, or from the log."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.evaluation.seen_as import rays_of
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.perception.coarse import cells_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.camera import Camera
    from hickory_stream.map_folder.history.recorded import RecordedKeyframe

# Step length along a ray, short enough to enter every voxel of structure on it, and the length of the ray.
_MARCH_M, _MARCH_TO_M = 0.025, 10.0


def place_in_keyframe(
    keyframe: RecordedKeyframe, pixel: tuple[float, float], code: int, voxel_m: float
) -> NDArray[np.float64] | None:
    """Return the point (3,) in the map that a pixel of a keyframe shows, None if the journal does not determine it."""
    observed, camera = keyframe.observed, keyframe.camera
    map_from_camera = keyframe.map_from_odometry @ observed.world_from_camera
    if 0 < code <= len(observed.observations):
        points = observed.observations[code - 1].points_world.astype(np.float64)
        in_image = project(apply(invert(observed.world_from_camera), points), camera)
        nearest = points[int(np.nanargmin(np.linalg.norm(in_image - np.array(pixel), axis=1)))]
        return np.asarray(apply(keyframe.map_from_odometry, nearest[None])[0])
    if observed.coarse is not None:
        depth_m = float(cells_of(observed.coarse, np.array([pixel]).round())[0][0])
    else:
        depth_m = _depth_of_structure(keyframe, pixel, voxel_m)
    if not np.isfinite(depth_m):
        return None
    return np.asarray(apply(map_from_camera, rays_of(camera, np.array([pixel])) * depth_m)[0])


def place_by_depth(
    depth_m: NDArray[np.float32], pixel: tuple[float, float], camera: Camera, map_from_camera: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    """Return the point (3,) in the map that a pixel of a frame with (H, W) depth shows, None if it has no depth."""
    depth = float(depth_m[round(pixel[1]), round(pixel[0])])
    if not (np.isfinite(depth) and depth > 0):
        return None
    return np.asarray(apply(map_from_camera, rays_of(camera, np.array([pixel])) * depth)[0])


def check_pixel(pixel: tuple[float, float], camera: Camera) -> None:
    """Check that a pixel is in the image.

    Raises:
        InputError: it is not.
    """
    if not (0 <= pixel[0] <= camera.width - 1 and 0 <= pixel[1] <= camera.height - 1):
        raise InputError(
            f"found the pixel {pixel[0]:g},{pixel[1]:g}, expected a column of 0 to {camera.width - 1} and a row of 0 "
            f"to {camera.height - 1}"
        )


def _depth_of_structure(keyframe: RecordedKeyframe, pixel: tuple[float, float], voxel_m: float) -> float:
    """Return the depth at which a pixel's ray meets the structure voxels of the keyframe, NaN if it meets none."""
    depths_m = np.arange(_MARCH_M, _MARCH_TO_M, _MARCH_M)
    ray = rays_of(keyframe.camera, np.array([pixel]))
    points = apply(keyframe.observed.world_from_camera, ray * depths_m[:, None])
    met = contains(keyframe.observed.space.structure_keys, keys_of_points(points, voxel_m))
    return float(depths_m[np.argmax(met)]) if met.any() else float("nan")
