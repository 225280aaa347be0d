"""The history of one point of the map: its label in every keyframe that shows it, and the objects there."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hickory_stream.inspection.point_sighting import AT_M, PlaceSighting, PlaceWhere, sighting_of
from hickory_stream.inspection.track_history import Stretch, TrackStory, ending_text, stretches_of, track_story
from hickory_stream.map_folder.history.recorded import final_snapshot, recorded_steps
from hickory_stream.map_folder.history.track_histories import TrackHistories
from hickory_stream.records import MapSnapshot, ObjectKind, Phase, kind_text

_IN_WORDS: dict[PlaceWhere, str] = {
    "mask": "in a mask",
    "rejected mask": "mask rejected",
    "structure": "taken for structure",
    "no depth": "no depth",
    "no mask": "in no mask",
    "hidden": "hidden",
    "looked through": "looked through",
}


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectThere:
    """An object at a point; `distance_m` is to its nearest point."""

    id: int
    phase: Phase
    kind: ObjectKind
    fixture_probability: float
    distance_m: float


@dataclass(frozen=True, kw_only=True, slots=True)
class AskedPixel:
    """The pixel of a query, and its label in that frame."""

    frame: int
    pixel: tuple[float, float]
    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class PlaceStory:
    """The history of a point: `point_m` in the map's world, None for a pixel without depth.

    `num_looking` of `num_keyframes` keyframes show it; `verdict` is the answer in a sentence. `floor_changes` are
    frames that changed the floor estimate, with reasons.
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
    floor_changes: tuple[str, ...] = ()


def story_of_point(path: Path, point_map: NDArray[np.float64], asked: AskedPixel | None = None) -> PlaceStory:
    """Return the history of a point (3,) of the map's world; raises `MapFolderError` for the map or its journal."""
    final = final_snapshot(path)
    book, sightings, floor_changes, num_keyframes = TrackHistories(), [], [], 0
    for step in recorded_steps(path, final):
        keyframe = step.keyframe
        book.add(None if keyframe is None else keyframe.observed.frame_index, step.decisions)
        if keyframe is not None:
            num_keyframes += 1
            changes = [decision.text for decision in step.decisions if decision.kind == "floor"]
            floor_changes += [f"frame {keyframe.observed.frame_index}: {text}" for text in changes]
            sighting = sighting_of(keyframe, point_map, book)
            if sighting is not None:
                sightings.append(sighting)
    there = _objects_at(final, point_map)
    tracks = sorted({s.track_id for s in sightings if s.where == "mask" and s.track_id is not None} & book.by_id.keys())
    x, y, z = (float(value) for value in point_map)
    return PlaceStory(
        point_m=(x, y, z),
        asked=asked,
        verdict=_verdict(there, sightings, book),
        objects=there,
        num_keyframes=num_keyframes,
        num_looking=len(sightings),
        tracks=tuple(track_story(book.by_id[i], book.final(i)) for i in tracks),
        stretches=stretches_of((s.frame, s.text) for s in sightings),
        sightings=tuple(sightings),
        floor_changes=tuple(floor_changes),
    )


def _objects_at(final: MapSnapshot, point_map: NDArray[np.float64]) -> tuple[ObjectThere, ...]:
    found = []
    for tracked in final.objects:
        if len(tracked.points_world):
            distance_m = float(cKDTree(tracked.points_world).query(point_map)[0])
            if distance_m <= AT_M:
                found.append(
                    ObjectThere(
                        id=tracked.id,
                        phase=tracked.phase,
                        kind=tracked.kind,
                        fixture_probability=tracked.fixture_probability,
                        distance_m=distance_m,
                    )
                )
    return tuple(sorted(found, key=lambda there: (there.distance_m, there.id)))


def _verdict(there: tuple[ObjectThere, ...], sightings: list[PlaceSighting], book: TrackHistories) -> str:
    if not sightings:
        text = "no keyframe has it in its image"
    else:
        counts = Counter(sighting.where for sighting in sightings)
        parts = ", ".join(f"{_IN_WORDS[w]} in {n}" for w, n in sorted(counts.items(), key=lambda kv: (-kv[1], kv[0])))
        text = f"of {len(sightings)} keyframes that have it in the image: {parts}"
    if there:
        return f"in #{there[0].id}, {kind_text(there[0].fixture_probability)}; {text}"
    tracks = Counter(s.track_id for s in sightings if s.where == "mask" and s.track_id is not None)
    ends = "; ".join(
        f"{count} of its masks went to {ending_text(book, i)}"
        for i, count in sorted(tracks.items(), key=lambda kv: (-kv[1], kv[0]))[:3]
    )
    return f"in no object; {text}" + (f"; {ends}" if ends else "")
