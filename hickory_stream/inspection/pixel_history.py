"""The history of the point that one pixel of a frame shows.

The point comes from the mask at the pixel, from recorded depth, or from the log.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import InputError
from hickory_stream.geometry.camera import Camera, project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.inspection.keyframe_labels import code_at, rays_of
from hickory_stream.inspection.point_history import AskedPixel, PlaceStory, story_of_point
from hickory_stream.inspection.point_sighting import meaning_of_code
from hickory_stream.map_folder.history.recorded import (
    RecordedKeyframe,
    final_snapshot,
    frame_indices,
    frame_pose,
    recorded_steps,
)
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.perception.coarse import cells_of


def place_in_keyframe(keyframe: RecordedKeyframe, pixel: tuple[float, float], code: int) -> NDArray[np.float64] | None:
    """Return the point (3,) in the map that a pixel of a keyframe shows, None if the journal does not determine it."""
    observed, camera = keyframe.observed, keyframe.camera
    map_from_camera = keyframe.map_from_odometry @ observed.world_from_camera
    if 0 < code <= len(observed.observations):
        points = observed.observations[code - 1].points_world.astype(np.float64)
        in_image = project(apply(invert(observed.world_from_camera), points), camera)
        nearest = points[int(np.nanargmin(np.linalg.norm(in_image - np.array(pixel), axis=1)))]
        return np.asarray(apply(keyframe.map_from_odometry, nearest[None])[0])
    depth_m = float(cells_of(keyframe.coarse, np.array([pixel]).round())[0][0])
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
    """Raise `InputError` for a pixel outside of the image."""
    if not (0 <= pixel[0] <= camera.width - 1 and 0 <= pixel[1] <= camera.height - 1):
        raise InputError(
            f"found the pixel {pixel[0]:g},{pixel[1]:g}, expected a column of 0 to {camera.width - 1} and a row of 0 "
            f"to {camera.height - 1}"
        )


def story_of_pixel(
    path: Path, frame: int, pixel: tuple[float, float], depth_of: Callable[[int], NDArray[np.float32]] | None = None
) -> PlaceStory:
    """Return the history of the point at `pixel` (column, row) of a frame of the log.

    `depth_of` returns the (H, W) depth of a stamp from the log. Raises `InputError` for an unknown frame or pixel, or
    if only the log has the point; `MapFolderError` for the map or its journal.
    """
    keyframes, frames = frame_indices(path)
    if frame not in frames:
        span = f"{frames[0]} to {frames[-1]}" if len(frames) else "none: its run ended before the first keyframe"
        raise InputError(f"found frame {frame}, expected one of the {len(frames)} frames of {path}: {span}")
    if frame in keyframes:
        return _story_of_keyframe_pixel(path, frame, pixel, depth_of)
    if depth_of is None:
        before, after = keyframes[keyframes < frame][-1:].tolist(), keyframes[keyframes > frame][:1].tolist()
        near = " or ".join(str(i) for i in (*before, *after))
        raise InputError(
            f"frame {frame} of {path} is no keyframe, so that no objects were detected in it; ask for the keyframe "
            f"{near}, or give --log LOG, to take the place from this frame's depth"
        )
    camera, pose = frame_pose(path, frame)
    check_pixel(pixel, camera)
    map_from_camera = _map_from_odometry(path, frame) @ pose.world_from_camera
    point = place_by_depth(depth_of(pose.stamp_ns), pixel, camera, map_from_camera)
    source = "the log has no depth there" if point is None else "the place is from the log's depth"
    text = f"the frame is no keyframe: {source}"
    return _followed(path, point, AskedPixel(frame=frame, pixel=pixel, text=text))


def _story_of_keyframe_pixel(
    path: Path, frame: int, pixel: tuple[float, float], depth_of: Callable[[int], NDArray[np.float32]] | None
) -> PlaceStory:
    final = final_snapshot(path)
    book = TrackHistories()
    # Of a frame that was played several times, the last playback counts.
    keyframe: RecordedKeyframe | None = None
    for step in recorded_steps(path, final):
        seen = step.keyframe
        book.add(None if seen is None else seen.observed.frame_index, step.decisions)
        if seen is not None and seen.observed.frame_index == frame:
            keyframe = seen
    assert keyframe is not None
    check_pixel(pixel, keyframe.camera)
    code = code_at(keyframe, pixel)
    _, _, text = meaning_of_code(keyframe, code, book)
    asked = AskedPixel(frame=frame, pixel=pixel, text=text)
    point = place_in_keyframe(keyframe, pixel, code)
    if point is None and depth_of is not None:
        map_from_camera = keyframe.map_from_odometry @ keyframe.observed.world_from_camera
        point = place_by_depth(depth_of(keyframe.observed.stamp_ns), pixel, keyframe.camera, map_from_camera)
    return _followed(path, point, asked)


def _map_from_odometry(path: Path, frame: int) -> NDArray[np.float64]:
    """Return the transform (4, 4) of the submap that was open when a frame arrived."""
    found = np.eye(4)
    for step in recorded_steps(path, final_snapshot(path)):
        if step.keyframe is not None and step.keyframe.observed.frame_index <= frame:
            found = step.keyframe.map_from_odometry
    return found


def _followed(path: Path, point: NDArray[np.float64] | None, asked: AskedPixel) -> PlaceStory:
    if point is not None:
        return story_of_point(path, point, asked)
    return PlaceStory(
        point_m=None,
        asked=asked,
        verdict=f"{asked.text}; without depth the pixel has no place that could be followed: ask for one beside it",
        objects=(),
        num_keyframes=len(frame_indices(path)[0]),
        num_looking=0,
        tracks=(),
        stretches=(),
        sightings=(),
    )
