"""The history of the point that one pixel of a frame shows.

The point is found from the mask at the pixel, from the depth that the journal keeps, or, if the journal has no depth of
this frame, from the log.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.evaluation.pixel_place import check_pixel, place_by_depth, place_in_keyframe
from hickory_stream.evaluation.place_sighting import meaning_of_code
from hickory_stream.evaluation.place_story import AskedPixel, PlaceStory, story_of_point
from hickory_stream.evaluation.seen_as import code_at, range_of
from hickory_stream.map_folder.history.recorded import final_snapshot, frame_indices, frame_pose, recorded_steps
from hickory_stream.map_folder.history.recorded_config import told_config
from hickory_stream.map_folder.history.track_histories import TrackHistories

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.map_folder.history.recorded import RecordedKeyframe


def story_of_pixel(
    path: Path,
    frame: int,
    pixel: tuple[float, float],
    depth_of: Callable[[int], NDArray[np.float32]] | None = None,
) -> PlaceStory:
    """Return the history of the point that a pixel shows.

    Args:
        path: the map folder.
        frame: the index of the frame, as the viewer's timeline `frame` has it.
        pixel: column and row.
        depth_of: returns the (H, W) depth of the log's frame of a stamp; None where there is no log.

    Raises:
        InputError: there is no such frame or pixel, or the point can only be found from the log.
        MapFolderError: there is no map or no journal, or it is damaged or of another version.
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
    final, config = final_snapshot(path), told_config(path)
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
    code = code_at(keyframe, pixel, range_of(config))
    _, _, text = meaning_of_code(keyframe, code, book)
    asked = AskedPixel(frame=frame, pixel=pixel, text=text)
    point = place_in_keyframe(keyframe, pixel, code, config.mapping.lattice.space_m)
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
    """Return the history of the point of a pixel, or, if the pixel has none, what this frame alone says of it."""
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
