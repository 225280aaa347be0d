"""What became of one place: what every keyframe that looks at it took it for, and what is there in the map.

The place is given, or is what a pixel of a frame shows: then it comes from the mask at that pixel, from the depth that
the journal keeps, or, for frames and journals that have none, from the log.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from scipy.spatial import cKDTree

from hickory_stream.engine.fates import FateBook
from hickory_stream.engine.recorded import final_snapshot, frame_indices, frame_pose, recorded_steps, told_config
from hickory_stream.errors import InputError
from hickory_stream.evaluation.seen_as import (
    NO_DEPTH,
    NO_MASK,
    STRUCTURE,
    Where,
    code_at,
    on_structure,
    range_of,
    rays_of,
    where_of,
)
from hickory_stream.evaluation.track_story import Stretch, TrackStory, ending_text, stretches_of, track_story
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.perception.coarse import cells_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.config import MapperConfig
    from hickory_stream.engine.recorded import RecordedKeyframe
    from hickory_stream.geometry.camera import Camera
    from hickory_stream.records import MapSnapshot, Observation, Phase

PlaceWhere = Literal[Where, "hidden", "looked through", "unknown"]

_IN_WORDS: dict[PlaceWhere, str] = {
    "mask": "in a mask",
    "rejected mask": "mask rejected",
    "structure": "taken for structure",
    "no depth": "no depth",
    "too near": "too near",
    "too far": "too far",
    "no mask": "in no mask",
    "hidden": "hidden",
    "looked through": "looked through",
    "unknown": "unknown",
}
_AT_M = 0.03
# How far depth may be off: three sigmas of a small stereo camera at one metre; it grows with the square.
_NOISE_M = 0.012
_MARCH_M, _MARCH_TO_M = 0.025, 10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class PlaceSighting:
    """What one keyframe took a place for; `pixel` is where it is in the image, `distance_m` how far.

    `track_id` is the track that the mask there went to, `text` says it in words. "hidden": something nearer is in the
    way; "looked through": what is seen there lies behind; "unknown": the journal is too old to tell.
    """

    frame: int
    keyframe: int
    stamp_ns: int
    pixel: tuple[float, float]
    distance_m: float
    where: PlaceWhere
    observation_index: int | None
    track_id: int | None
    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectThere:
    """An object of the map at a place: `distance_m` to its nearest point."""

    id: int
    phase: Phase
    distance_m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class AskedPixel:
    """The pixel that was asked for, and what it was in that frame."""

    frame: int
    pixel: tuple[float, float]
    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class PlaceStory:
    """The fate of a place: `point_m` in the map's world, None where a pixel has none.

    `num_looking` of `num_keyframes` keyframes have it in the image; `verdict` is the answer in a sentence.
    """

    point_m: tuple[float, float, float] | None
    asked: AskedPixel | None
    verdict: str
    objects: tuple[ObjectThere, ...]
    num_keyframes: int
    num_looking: int
    tracks: tuple[TrackStory, ...]
    stretches: tuple[Stretch, ...]
    sightings: tuple[PlaceSighting, ...]


def story_of_point(path: Path, point_map: NDArray[np.float64], asked: AskedPixel | None = None) -> PlaceStory:
    """Return the fate of a point (3,) of the map's world.

    Raises:
        MapFolderError: there is no map or no journal, or it is damaged or of another version.
    """
    final, config = final_snapshot(path), told_config(path)
    book, sightings, num_keyframes = FateBook(), [], 0
    for step in recorded_steps(path, final):
        keyframe = step.keyframe
        book.add(None if keyframe is None else keyframe.observed.frame_index, step.decisions)
        if keyframe is not None:
            num_keyframes += 1
            sighting = sighting_of(keyframe, point_map, config, book)
            if sighting is not None:
                sightings.append(sighting)
    there = _objects_at(final, point_map)
    tracks = sorted({s.track_id for s in sightings if s.where == "mask" and s.track_id is not None} & book.fates.keys())
    x, y, z = (float(value) for value in point_map)
    return PlaceStory(
        point_m=(x, y, z),
        asked=asked,
        verdict=_verdict(there, sightings, book),
        objects=there,
        num_keyframes=num_keyframes,
        num_looking=len(sightings),
        tracks=tuple(track_story(book.fates[i], book.final(i)) for i in tracks),
        stretches=stretches_of((s.frame, s.text) for s in sightings),
        sightings=tuple(sightings),
    )


def story_of_pixel(
    path: Path,
    frame: int,
    pixel: tuple[float, float],
    depth_of: Callable[[int], NDArray[np.float32]] | None = None,
) -> PlaceStory:
    """Return the fate of what a pixel shows.

    Args:
        path: the map folder.
        frame: the index of the frame, as the viewer's timeline `frame` has it.
        pixel: column and row.
        depth_of: returns the (H, W) depth of the log's frame of a stamp; None where there is no log.

    Raises:
        InputError: there is no such frame or pixel, or only the log can tell what is there.
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
            f"frame {frame} of {path} is no keyframe, so that nothing was looked for in it; ask for the keyframe "
            f"{near}, or give --log LOG, to take the place from this frame's depth"
        )
    camera, pose = frame_pose(path, frame)
    _check_pixel(pixel, camera)
    map_from_camera = _map_from_odometry(path, frame) @ pose.world_from_camera
    point = _point_of(depth_of(pose.stamp_ns), pixel, camera, map_from_camera)
    source = "the log has no depth there" if point is None else "the place is from the log's depth"
    text = f"the frame is no keyframe: {source}"
    return _followed(path, point, AskedPixel(frame=frame, pixel=pixel, text=text))


def sighting_of(
    keyframe: RecordedKeyframe, point_map: NDArray[np.float64], config: MapperConfig, book: FateBook
) -> PlaceSighting | None:
    """Return what a keyframe took a point for, None where it is not in the image."""
    observed, camera = keyframe.observed, keyframe.camera
    point = apply(keyframe.odometry_from_map, np.asarray(point_map, dtype=np.float64)[None])
    in_camera = apply(invert(observed.world_from_camera), point)
    ((u, v),) = project(in_camera, camera).tolist()
    if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
        return None
    where, index, text = _taken_for(keyframe, point, (u, v), float(in_camera[0, 2]), config, book)
    return PlaceSighting(
        frame=observed.frame_index,
        keyframe=keyframe.number,
        stamp_ns=observed.stamp_ns,
        pixel=(round(u, 1), round(v, 1)),
        distance_m=float(np.linalg.norm(in_camera)),
        where=where,
        observation_index=index,
        track_id=None if index is None else book.home(observed.frame_index, index),
        text=text,
    )


def _taken_for(
    keyframe: RecordedKeyframe,
    point: NDArray[np.float64],
    pixel: tuple[float, float],
    depth_m: float,
    config: MapperConfig,
    book: FateBook,
) -> tuple[PlaceWhere, int | None, str]:
    """Return what a point (1, 3) of the odometry's world was taken for, its observation, and both in words."""
    observed, voxel_m = keyframe.observed, config.mapping.lattice.space_m
    noise_m = _AT_M + _NOISE_M * depth_m * depth_m
    index = _nearest_observation(observed.observations, point, min(noise_m, 2 * _AT_M))
    if index is not None:
        return "mask", index, _mask_text(keyframe, index, book)
    code = code_at(keyframe, pixel, range_of(config))
    where = where_of(code, len(observed.observations))
    if observed.coarse is not None:
        measured_m = float(cells_of(observed.coarse, np.array([pixel]).round())[0][0])
        if not np.isfinite(measured_m):
            return ("no depth", None, "no depth there") if where != "rejected mask" else _plain(keyframe, code, book)
        if measured_m < depth_m - noise_m:
            return "hidden", None, f"hidden by {_name_of(keyframe, code, book)}"
        if measured_m > depth_m + noise_m:
            return "looked through", None, "looked through: what is seen there lies behind"
        return _plain(keyframe, code, book)
    if where == "rejected mask":
        return _plain(keyframe, code, book)
    if on_structure(keyframe, point, voxel_m)[0]:
        return "structure", None, "taken for structure"
    if contains(observed.space.free_keys, keys_of_points(point, voxel_m))[0]:
        return "looked through", None, "looked through: what is seen there lies behind"
    if where == "mask":
        return "hidden", None, f"hidden by, or at the edge of, {_name_of(keyframe, code, book)}"
    return "unknown", None, "in no mask, and neither structure nor free (the journal is too old to have depth)"


def _plain(keyframe: RecordedKeyframe, code: int, book: FateBook) -> tuple[PlaceWhere, int | None, str]:
    """Return what a pixel's code says of a point that is seen there."""
    count = len(keyframe.observed.observations)
    where = where_of(code, count)
    if where == "mask":
        return where, code - 1, _mask_text(keyframe, code - 1, book)
    if where == "rejected mask":
        return where, None, f"its mask was rejected: {keyframe.observed.rejected[code - count - 1].reason}"
    texts = {STRUCTURE: "taken for structure", NO_MASK: "in no mask", NO_DEPTH: "no depth there"}
    return where, None, texts.get(code, f"{where} to be observed")


def _mask_text(keyframe: RecordedKeyframe, index: int, book: FateBook) -> str:
    track_id = book.home(keyframe.observed.frame_index, index)
    return f"in a mask that went to #{track_id}" if track_id is not None else "in a mask"


def _name_of(keyframe: RecordedKeyframe, code: int, book: FateBook) -> str:
    where = where_of(code, len(keyframe.observed.observations))
    if where == "mask":
        track_id = book.home(keyframe.observed.frame_index, code - 1)
        return f"#{track_id}" if track_id is not None else "a mask"
    return "structure" if where == "structure" else "something nearer"


def _nearest_observation(
    observations: tuple[Observation, ...], point: NDArray[np.float64], reach_m: float
) -> int | None:
    """Return the place of the observation that has a point within reach of (1, 3), the nearest one."""
    found: list[tuple[float, int]] = []
    for i, observation in enumerate(observations):
        if len(observation.points_world) == 0 or not observation.box.contains(point, 2 * reach_m)[0]:
            continue
        nearest_m = float(np.linalg.norm(observation.points_world - point, axis=1).min())
        if nearest_m <= reach_m:
            found.append((nearest_m, i))
    return min(found)[1] if found else None


def _objects_at(final: MapSnapshot, point_map: NDArray[np.float64]) -> tuple[ObjectThere, ...]:
    found = []
    for tracked in final.objects:
        if len(tracked.points_world):
            distance_m = float(cKDTree(tracked.points_world).query(point_map)[0])
            if distance_m <= _AT_M:
                found.append(ObjectThere(id=tracked.id, phase=tracked.phase, distance_m=distance_m))
    return tuple(sorted(found, key=lambda there: (there.distance_m, there.id)))


def _verdict(there: tuple[ObjectThere, ...], sightings: list[PlaceSighting], book: FateBook) -> str:
    if not sightings:
        told = "no keyframe has it in its image"
    else:
        counts = Counter(sighting.where for sighting in sightings)
        parts = ", ".join(f"{_IN_WORDS[w]} in {n}" for w, n in sorted(counts.items(), key=lambda kv: (-kv[1], kv[0])))
        told = f"of {len(sightings)} keyframes that have it in the image: {parts}"
    if there:
        return f"in object #{there[0].id}; {told}"
    tracks = Counter(s.track_id for s in sightings if s.where == "mask" and s.track_id is not None)
    ends = "; ".join(
        f"{count} of its masks went to {ending_text(book, i)}"
        for i, count in sorted(tracks.items(), key=lambda kv: (-kv[1], kv[0]))[:3]
    )
    return f"in no object; {told}" + (f"; {ends}" if ends else "")


# ---- from a pixel to a place ----------------------------------------------------------------------------------------


def _map_from_odometry(path: Path, frame: int) -> NDArray[np.float64]:
    """Return (4, 4) where the submap lies that was open when a frame came."""
    found = np.eye(4)
    for step in recorded_steps(path, final_snapshot(path)):
        if step.keyframe is not None and step.keyframe.observed.frame_index <= frame:
            found = step.keyframe.map_from_odometry
    return found


def _story_of_keyframe_pixel(
    path: Path, frame: int, pixel: tuple[float, float], depth_of: Callable[[int], NDArray[np.float32]] | None
) -> PlaceStory:
    final, config = final_snapshot(path), told_config(path)
    book = FateBook()
    # A frame that was played again is told as it was the last time.
    keyframe: RecordedKeyframe | None = None
    for step in recorded_steps(path, final):
        seen = step.keyframe
        book.add(None if seen is None else seen.observed.frame_index, step.decisions)
        if seen is not None and seen.observed.frame_index == frame:
            keyframe = seen
    assert keyframe is not None
    _check_pixel(pixel, keyframe.camera)
    code = code_at(keyframe, pixel, range_of(config))
    _, _, text = _plain(keyframe, code, book)
    asked = AskedPixel(frame=frame, pixel=pixel, text=text)
    point = _place_of_pixel(keyframe, pixel, code, config.mapping.lattice.space_m)
    if point is None and depth_of is not None:
        map_from_camera = keyframe.map_from_odometry @ keyframe.observed.world_from_camera
        point = _point_of(depth_of(keyframe.observed.stamp_ns), pixel, keyframe.camera, map_from_camera)
    return _followed(path, point, asked)


def _followed(path: Path, point: NDArray[np.float64] | None, asked: AskedPixel) -> PlaceStory:
    """Return the story of the place of a pixel, or, where it has none, what the frame itself says."""
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


def _place_of_pixel(
    keyframe: RecordedKeyframe, pixel: tuple[float, float], code: int, voxel_m: float
) -> NDArray[np.float64] | None:
    """Return (3,) where in the map a pixel of a keyframe is, None where the journal cannot tell."""
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


def _depth_of_structure(keyframe: RecordedKeyframe, pixel: tuple[float, float], voxel_m: float) -> float:
    """Return the depth at which a pixel's ray meets what the keyframe saw as structure, NaN where it meets none."""
    depths_m = np.arange(_MARCH_M, _MARCH_TO_M, _MARCH_M)
    ray = rays_of(keyframe.camera, np.array([pixel]))
    points = apply(keyframe.observed.world_from_camera, ray * depths_m[:, None])
    met = contains(keyframe.observed.space.structure_keys, keys_of_points(points, voxel_m))
    return float(depths_m[np.argmax(met)]) if met.any() else float("nan")


def _point_of(
    depth_m: NDArray[np.float32], pixel: tuple[float, float], camera: Camera, map_from_camera: NDArray[np.float64]
) -> NDArray[np.float64] | None:
    depth = float(depth_m[round(pixel[1]), round(pixel[0])])
    if not (np.isfinite(depth) and depth > 0):
        return None
    return np.asarray(apply(map_from_camera, rays_of(camera, np.array([pixel])) * depth)[0])


def _check_pixel(pixel: tuple[float, float], camera: Camera) -> None:
    if not (0 <= pixel[0] <= camera.width - 1 and 0 <= pixel[1] <= camera.height - 1):
        raise InputError(
            f"found the pixel {pixel[0]:g},{pixel[1]:g}, expected a column of 0 to {camera.width - 1} and a row of 0 "
            f"to {camera.height - 1}"
        )
