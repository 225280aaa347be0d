"""The label of a point of the map in one keyframe: mask, rejected mask, structure, occluded, or no depth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from hickory_stream.geometry.camera import project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.inspection.keyframe_labels import NO_DEPTH, NO_MASK, STRUCTURE, Where, code_at, where_of
from hickory_stream.perception.coarse import cells_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.map_folder.history.recorded import RecordedKeyframe
    from hickory_stream.map_folder.history.track_histories import TrackHistories
    from hickory_stream.records import Observation

PlaceWhere = Literal[Where, "hidden", "looked through"]

AT_M = 0.03
"""Largest distance from a point at which a surface or a mask still belongs to it."""

# Depth tolerance at one metre: three sigmas of a small stereo camera; it grows with the square of the depth.
_NOISE_M = 0.012


@dataclass(frozen=True, kw_only=True, slots=True)
class PlaceSighting:
    """The label of a point in one keyframe; `pixel` is its projection, `distance_m` its distance from the camera.

    "hidden": a nearer surface occludes the point; "looked through": the depth is behind it.
    """

    frame: int
    keyframe: int
    stamp_ns: int
    pixel: tuple[float, float]
    distance_m: float
    where: PlaceWhere
    observation_index: int | None
    #: track of the mask at the point
    track_id: int | None
    #: the label in words
    text: str


def sighting_of(
    keyframe: RecordedKeyframe, point_map: NDArray[np.float64], book: TrackHistories
) -> PlaceSighting | None:
    """Return the label of a point in a keyframe, None if it is not in the image."""
    observed, camera = keyframe.observed, keyframe.camera
    point = apply(keyframe.odometry_from_map, np.asarray(point_map, dtype=np.float64)[None])
    in_camera = apply(invert(observed.world_from_camera), point)
    ((u, v),) = project(in_camera, camera).tolist()
    if not (-0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5):
        return None
    where, index, text = _taken_for(keyframe, point, (u, v), float(in_camera[0, 2]), book)
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


def meaning_of_code(keyframe: RecordedKeyframe, code: int, book: TrackHistories) -> tuple[PlaceWhere, int | None, str]:
    """Return the label of a pixel's code, the index of its observation, and both in words."""
    count = len(keyframe.observed.observations)
    where = where_of(code, count)
    if where == "mask":
        return where, code - 1, _mask_text(keyframe, code - 1, book)
    if where == "rejected mask":
        return where, None, f"its mask was rejected: {keyframe.observed.rejected[code - count - 1].reason}"
    return where, None, {STRUCTURE: "taken for structure", NO_MASK: "in no mask", NO_DEPTH: "no depth there"}[code]


def _taken_for(
    keyframe: RecordedKeyframe,
    point: NDArray[np.float64],
    pixel: tuple[float, float],
    depth_m: float,
    book: TrackHistories,
) -> tuple[PlaceWhere, int | None, str]:
    """Return the label of a point (1, 3) in the odometry's world, the index of its observation, and both in words."""
    observed = keyframe.observed
    noise_m = AT_M + _NOISE_M * depth_m * depth_m
    index = _nearest_observation(observed.observations, point, min(noise_m, 2 * AT_M))
    if index is not None:
        return "mask", index, _mask_text(keyframe, index, book)
    code = code_at(keyframe, pixel)
    where, seen_there = where_of(code, len(observed.observations)), meaning_of_code(keyframe, code, book)
    measured_m = float(cells_of(keyframe.coarse, np.array([pixel]).round())[0][0])
    if not np.isfinite(measured_m):
        return seen_there if where == "rejected mask" else ("no depth", None, "no depth there")
    if measured_m < depth_m - noise_m:
        return "hidden", None, f"hidden by {_name_of(keyframe, code, book)}"
    if measured_m > depth_m + noise_m:
        return "looked through", None, "looked through: what is seen there lies behind"
    return seen_there


def _mask_text(keyframe: RecordedKeyframe, index: int, book: TrackHistories) -> str:
    track_id = book.home(keyframe.observed.frame_index, index)
    return f"in a mask that went to #{track_id}" if track_id is not None else "in a mask"


def _name_of(keyframe: RecordedKeyframe, code: int, book: TrackHistories) -> str:
    where = where_of(code, len(keyframe.observed.observations))
    if where == "mask":
        track_id = book.home(keyframe.observed.frame_index, code - 1)
        return f"#{track_id}" if track_id is not None else "a mask"
    return "structure" if where == "structure" else "something nearer"


def _nearest_observation(
    observations: tuple[Observation, ...], point: NDArray[np.float64], reach_m: float
) -> int | None:
    """Return the index of the observation with the point nearest to (1, 3), None if none is within the tolerance."""
    found: list[tuple[float, int]] = []
    for i, observation in enumerate(observations):
        if len(observation.points_world) == 0 or not observation.box.contains(point, 2 * reach_m)[0]:
            continue
        nearest_m = float(np.linalg.norm(observation.points_world - point, axis=1).min())
        if nearest_m <= reach_m:
            found.append((nearest_m, i))
    return min(found)[1] if found else None
