"""Public records of the map: tracks and submaps. Records of what did not change are reused."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.mapping.moved import moved_object
from hickory_stream.mapping.observed_space import as_record, without_room
from hickory_stream.mapping.submaps import record_of
from hickory_stream.mapping.track import as_object
from hickory_stream.records import MapPrior, MapSnapshot, Phase

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.submaps import SubmapState
    from hickory_stream.mapping.track import Track
    from hickory_stream.records import ObservedSpace, Submap, TrackedObject


class Snapshots:
    """Makes the public records of a state; caches the last ones for reuse."""

    def __init__(self, points_m: float) -> None:
        self._points_m = points_m
        self._objects: dict[int, tuple[Track, NDArray[np.float64], TrackedObject]] = {}
        self._submaps: dict[int, tuple[SubmapState, Submap]] = {}

    def snapshot(self, state: MapState) -> MapSnapshot:
        """Return the map as it is now."""
        shown = {
            track.id: self._shown(track, state.submaps.world_from(track.submap_id))
            for track in state.everywhere()
            if track.phase is not Phase.ROOM
        }
        self._objects = shown
        return MapSnapshot(
            revision=state.revision,
            stamp_ns=state.stamp_ns or 0,
            submaps=tuple(self._submap(submap) for submap in state.submaps.states),
            objects=tuple(item for _, _, item in shown.values()),
            graph=state.graph,
        )

    def prior(self, state: MapState) -> MapPrior | None:
        """Return the map prior for perception, in the odometry frame (without corrections); None before a keyframe.

        It has the space and the objects seen since the last jump of the odometry, across submap borders.
        """
        if state.revision == 0:
            return None
        return MapPrior(space=self._observed_space(state), objects=self._known_objects(state), points_m=self._points_m)

    def _observed_space(self, state: MapState) -> ObservedSpace:
        submaps = state.submaps
        space = submaps.space
        if len(space.room):
            # Without tracks that are part of the room: conclusions of the map must not become evidence for themselves.
            return as_record(without_room(space))
        is_one = submaps.first == submaps.open_id
        return self._submap(submaps.states[-1]).observed_space if is_one else as_record(space)

    def _known_objects(self, state: MapState) -> tuple[TrackedObject, ...]:
        known = []
        for track in state.ordered():
            if state.is_judged(track) and track.phase is not Phase.ROOM:
                shown = self._objects.get(track.id)
                is_there = shown is not None and shown[0] is track and np.array_equal(shown[1], np.eye(4))
                known.append(shown[2] if shown is not None and is_there else as_object(track))
        return tuple(known)

    def _shown(self, track: Track, place: NDArray[np.float64]) -> tuple[Track, NDArray[np.float64], TrackedObject]:
        shown = self._objects.get(track.id)
        if shown is None or shown[0] is not track or shown[1] is not place:
            shown = (track, place, _in_world(as_object(track), place))
        return shown

    def _submap(self, state: SubmapState) -> Submap:
        shown = self._submaps.get(state.id)
        if shown is None or shown[0] is not state:
            shown = self._submaps[state.id] = (state, record_of(state))
        return shown[1]


def metrics_of(state: MapState) -> tuple[tuple[str, float], ...]:
    """Return named numbers for plots: tracks by phase, the share of masks without computed features, best scores."""
    counts = [(f"core/{phase}", float(sum(t.phase is phase for t in state.everywhere()))) for phase in Phase]
    scores = [
        (f"score/{track.id}", track.best_view.score)
        for track in state.everywhere()
        if track.best_view is not None and track.best_view.score is not None
    ]
    saved = 1.0 - state.num_features / state.num_masks if state.num_masks else 0.0
    return (*counts, ("core/features_saved", saved), *scores)


def _in_world(item: TrackedObject, world_from_submap: NDArray[np.float64]) -> TrackedObject:
    """Return an object at its submap's corrected pose; the unchanged record if the pose was not corrected."""
    return item if np.array_equal(world_from_submap, np.eye(4)) else moved_object(item, world_from_submap)
