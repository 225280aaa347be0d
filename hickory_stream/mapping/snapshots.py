"""Public records of the map; records of unchanged tracks and submaps are reused."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.lazy_arrays import give_up, has_given_up, made_of, read_briefly
from hickory_stream.geometry.rigid import apply
from hickory_stream.mapping.entities.observed_space import SpaceState, as_record
from hickory_stream.mapping.entities.rigid_motion import moved_object
from hickory_stream.mapping.entities.submaps import LEAST_BESIDE_M, SubmapState, record_of_space, shown_space
from hickory_stream.mapping.entities.track import Track, as_object
from hickory_stream.mapping.entities.track_table import Mark
from hickory_stream.mapping.map_state import MapState
from hickory_stream.records import MapPrior, MapSnapshot, ObjectKind, ObservedSpace, Phase, Submap, TrackedObject

_NO_KEYS = np.empty(0, dtype=np.int64)
_NO_POINTS, _NO_COLORS = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)


@dataclass(frozen=True, slots=True)
class _Shown:
    # The records of a track: in the frame of its submap, and at that submap's pose (4, 4).
    track: Track
    own: TrackedObject
    place: NDArray[np.float64]
    item: TrackedObject


class Snapshots:
    """Makes the public records of a state; each shares unchanged parts with the last one."""

    def __init__(self, points_m: float) -> None:
        self._points_m = points_m
        self._marks: tuple[Mark, Mark] | None = None
        self._places: dict[int, NDArray[np.float64]] = {}
        self._objects: dict[int, _Shown] = {}
        self._submaps: dict[int, tuple[SubmapState, Submap, bool]] = {}
        self._phases: dict[int, Phase] = {}
        self._num_of: Counter[Phase] = Counter()
        self._scores: dict[int, float] = {}

    def snapshot(self, state: MapState) -> MapSnapshot:
        """Return the present map."""
        self._follow(state)
        return MapSnapshot(
            revision=state.revision,
            stamp_ns=state.stamp_ns or 0,
            submaps=tuple(self._submap(submap) for submap in state.submaps.states),
            objects=tuple(shown.item for shown in self._objects.values()),
            graph=state.graph,
        )

    def metrics(self, state: MapState) -> tuple[tuple[str, float], ...]:
        """Return named numbers for plots: tracks by phase, the share of masks without features, changed scores."""
        self._follow(state)
        counts = [(f"core/{phase}", float(self._num_of[phase])) for phase in Phase]
        saved = 1.0 - state.num_features / state.num_masks if state.num_masks else 0.0
        scores, self._scores = self._scores, {}
        best = [(f"score/{track_id}", score) for track_id, score in sorted(scores.items())]
        return (*counts, ("core/features_saved", saved), *best)

    def prior(self, state: MapState) -> MapPrior | None:
        """Return the map prior (see `MapperCore.prior`)."""
        if state.revision == 0:
            return None
        return MapPrior(space=self._observed_space(state), objects=self._known_objects(state), points_m=self._points_m)

    def _observed_space(self, state: MapState) -> ObservedSpace:
        submaps = state.submaps
        is_one = submaps.first == submaps.open_id
        return self._submap(submaps.states[-1]).observed_space if is_one else as_record(submaps.space)

    def _known_objects(self, state: MapState) -> tuple[TrackedObject, ...]:
        # As far around the last view as the space reaches at least.
        near = state.tracks.ordered() if state.sight is None else state.tracks.touching(state.sight, LEAST_BESIDE_M)
        # Not fixtures, which may be pieces of a wall: the map must not confirm itself.
        known = (track for track in near if state.is_judged(track) and track.kind is not ObjectKind.FIXTURE)
        return tuple(self._own(track) for track in known)

    def _follow(self, state: MapState) -> None:
        tables, marks = (state.tracks, state.elsewhere), self._marks
        places = {submap.id: submap.world_from_submap for submap in state.submaps.states}
        is_placed_anew = any(places.get(i) is not place for i, place in self._places.items())
        self._places = places
        if marks is None or is_placed_anew or any(m.table is not t for m, t in zip(marks, tables, strict=True)):
            marks = None
            for track_id in self._phases.keys() - state.tracks.keys() - state.elsewhere.keys():
                self._take(state, track_id)
        for table, mark in zip(tables, marks or (None, None), strict=True):
            for track_id in table.changed_since(mark):
                self._take(state, track_id)
        self._marks = (state.tracks.now, state.elsewhere.now)

    def _take(self, state: MapState, track_id: int) -> None:
        track = state.tracks.get(track_id) or state.elsewhere.get(track_id)
        phase = None if track is None else track.phase
        if (before := self._phases.pop(track_id, None)) is not None:
            self._num_of[before] -= 1
        if phase is not None:
            self._phases[track_id] = phase
            self._num_of[phase] += 1
        if track is None:
            self._objects.pop(track_id, None)
        else:
            is_between = track_id not in self._objects and track_id < next(reversed(self._objects), 0)
            self._objects[track_id] = self._shown(track, state.submaps.world_from(track.submap_id))
            if is_between:
                self._objects = dict(sorted(self._objects.items()))
        if track is not None and track.best_view is not None and track.best_view.score is not None:
            self._scores[track_id] = track.best_view.score

    def _own(self, track: Track) -> TrackedObject:
        shown = self._objects.get(track.id)
        return shown.own if shown is not None and shown.track is track else as_object(track, self._points_m)

    def _shown(self, track: Track, place: NDArray[np.float64]) -> _Shown:
        shown = self._objects.get(track.id)
        if shown is not None and shown.track is track and shown.place is place:
            return shown
        own = self._own(track)
        before = (shown.own, shown.item) if shown is not None and shown.place is place else None
        return _Shown(track, own, place, _in_world(own, place, before))

    def _submap(self, state: SubmapState) -> Submap:
        shown = self._submaps.get(state.id)
        if shown is None or shown[0] is not state:
            shown = self._submaps[state.id] = (state, *_record_of(state, shown))
        _, submap, gives_up = shown
        if not gives_up and has_given_up(shown_space(state)):
            # A record whose space is compressed does not hold it either.
            _give_up_space(submap.observed_space, shown_space(state), state.outdated)
            self._submaps[state.id] = (state, submap, True)
        return submap


def _record_of(state: SubmapState, shown: tuple[SubmapState, Submap, bool] | None) -> tuple[Submap, bool]:
    # The record of a submap, and whether its space is compressed; `shown` is the last one.
    space, outdated = shown_space(state), state.outdated
    if shown is not None and shown_space(shown[0]) is space and shown[0].outdated is outdated:
        _, submap, is_compressed = shown
        is_there = submap.world_from_submap is state.world_from_submap
        return submap if is_there else replace(submap, world_from_submap=state.world_from_submap), is_compressed
    if is_compressed := has_given_up(space):
        seen = ObservedSpace(voxel_m=space.voxel_m, free=_NO_KEYS, structure=_NO_KEYS, floor_z_m=space.floor_z_m)
        _give_up_space(seen, space, outdated)
    else:
        seen = record_of_space(space, outdated)
    return Submap(id=state.id, world_from_submap=state.world_from_submap, observed_space=seen), is_compressed


def _give_up_space(seen: ObservedSpace, space: SpaceState, outdated: NDArray[np.int64] | None) -> None:
    def array_of(name: str) -> NDArray[Any]:
        with read_briefly(space):
            array: NDArray[Any] = getattr(record_of_space(space, outdated), name)
        return array

    give_up(seen, array_of, "free", "structure")


def _in_world(
    item: TrackedObject, world_from_submap: NDArray[np.float64], before: tuple[TrackedObject, TrackedObject] | None
) -> TrackedObject:
    if np.array_equal(world_from_submap, np.eye(4)):
        return item

    def moved_array(name: str) -> NDArray[Any]:
        return apply(world_from_submap, item.points_world) if name == "points_world" else item.colors

    # Without its arrays, which are made when they are read.
    bare, known = replace(item, points_world=_NO_POINTS, colors=_NO_COLORS), made_of(item)
    moved = moved_object(bare, world_from_submap, before)
    give_up(moved, moved_array, "points_world", "colors", of=(*known, world_from_submap) if known else ())
    return moved
