"""The core of the mapper: every decision about the map, as a function of the events alone.

`MapperCore.handle(event)` is synchronous: no I/O, no clock, no randomness. The same events in the same order give the
same map, to the byte. What happens in a keyframe is listed in `_keyframe`; each step is a module of its own.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, assert_never

from hickory_stream.events import (
    ComputeFeatures,
    Effect,
    Event,
    FeaturesReady,
    FrameObserved,
    KeyframeKeptOut,
    KeyframeRegistered,
    LoopsSearched,
    PoseJumped,
    PosesCorrected,
    Publish,
    SearchLoops,
    ShapeFailed,
    ShapeReady,
    SourceEnded,
    TimeJumped,
    WayEnded,
)
from hickory_stream.mapping.best_views import drop_unused_views, judge_views, propose_views
from hickory_stream.mapping.invariants import validate
from hickory_stream.mapping.jumps import pose_jumped, time_jumped
from hickory_stream.mapping.keyframe_steps import begin_keyframe, note_registration, see_space
from hickory_stream.mapping.loop_searches import end_search, end_submap
from hickory_stream.mapping.map_state import MapState, PendingFeatures
from hickory_stream.mapping.moved_submaps import end_elsewhere, place_submaps, recognise
from hickory_stream.mapping.shape_requests import end_shape, request_shapes
from hickory_stream.mapping.snapshots import Snapshots
from hickory_stream.mapping.submaps import first_submap
from hickory_stream.mapping.track_ageing import age_tracks, end_tracks, keep_room
from hickory_stream.mapping.track_splitting import moved_out, split_tracks
from hickory_stream.mapping.tracker import Tracker

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from hickory_stream.geometry.made_arrays import Keep
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.submaps import SubmapState
    from hickory_stream.mapping.tracker import Associator
    from hickory_stream.records import Loop, MapPrior, MapSnapshot, PoseGraphRecord

logger = logging.getLogger(__name__)


class MapperCore:
    """Holds the map; only `handle` changes it.

    `associator` replaces the data association by boxes and points (see `Tracker`); a core that is restored from a
    saved state has none.
    """

    def __init__(self, config: MappingConfig, associator: Associator | None = None) -> None:
        self._config = config
        self._tracker = Tracker(config, associator)
        self._snapshots = Snapshots(config.lattice.points_m)
        self._state = _new_map(config)

    def handle(self, event: Event) -> list[Effect]:
        """Apply an event to the map and return the effects that the caller has to carry out.

        Raises:
            ValueError: the event is not expected now, e.g. features of a keyframe that is not pending.
            InvariantError: an invariant of the state is broken; checked only if debug messages are logged (`--debug`).
        """
        effects = self._handled(event)
        if logger.isEnabledFor(logging.DEBUG):
            validate(self._state)
        return effects

    def validate(self) -> None:
        """Check the invariants of the map's state; raises `InvariantError`."""
        validate(self._state)

    def _handled(self, event: Event) -> list[Effect]:
        match event:
            case FrameObserved():
                return self._keyframe(event)
            case FeaturesReady():
                return self._features_ready(event)
            case ShapeReady() | ShapeFailed():
                end_shape(self._state, event)
                return []
            case TimeJumped():
                time_jumped(self._state, event)
                return []
            case PoseJumped():
                open_id = self._state.submaps.open_id
                pose_jumped(self._state, event, self._config)
                return [*end_submap(self._state, open_id, self.snapshot, self._config.submaps)]
            case PosesCorrected():
                return self._poses_corrected(event)
            case LoopsSearched():
                end_search(self._state, event)
                return []
            case WayEnded():
                return [*end_submap(self._state, None, self.snapshot, self._config.submaps)]
            case KeyframeRegistered():
                note_registration(self._state, event)
                return []
            case KeyframeKeptOut():
                self._state.decide("keep_out", None, f"frame {event.frame_index} is kept out: {event.reason}")
                return []
            case SourceEnded():
                return self._source_ended()
            case _:
                assert_never(event)

    def _keyframe(self, event: FrameObserved) -> list[Effect]:
        state, config, tracker = self._state, self._config, self._tracker
        open_id = state.submaps.open_id
        begin_keyframe(state, event, config)
        effects: list[Effect] = [*end_submap(state, open_id, self.snapshot, config.submaps)]
        effects += recognise(state, event, config)
        sightings = tracker.track(state, event)
        seen_ids = {sighting.track_id for sighting in sightings}
        promoted = split_tracks(state, event, seen_ids, config)
        sightings = moved_out(state, sightings, promoted, config)
        changed_ids = {*(sighting.track_id for sighting in sightings), *promoted, *promoted.values()}
        effects += tracker.merge_tracks(state, changed_ids)
        state.stirred |= changed_ids
        effects += age_tracks(state, event, config, merges=not tracker.is_told)
        see_space(state, event)
        candidates, keeps = propose_views(state, event, sightings, config.views)
        effects += keeps
        state.num_masks += len(event.observations)
        object_ids = tuple(state.current_id(sighting.track_id) for sighting in sightings)
        if not candidates:
            return [*effects, *self._conclude(object_ids)]
        state.num_features += len(candidates)
        state.pending = PendingFeatures(frame_index=event.frame_index, candidates=candidates, object_ids=object_ids)
        return [
            *effects,
            ComputeFeatures(frame_index=event.frame_index, observation_indices=tuple(sorted(candidates))),
        ]

    def _features_ready(self, event: FeaturesReady) -> list[Effect]:
        state, pending = self._state, self._state.pending
        if pending is None or pending.frame_index != event.frame_index:
            raise ValueError(f"features of frame {event.frame_index} were not asked for")
        state.pending = None
        return [*judge_views(state, pending, event, self._config.views), *self._conclude(pending.object_ids)]

    def _conclude(self, object_ids: tuple[int | None, ...], *, is_final: bool = False) -> list[Effect]:
        """Return the effects that end a keyframe or the source: shape requests, dropped views and the publication."""
        state = self._state
        return [
            *request_shapes(state, self._config, is_final=is_final),
            *drop_unused_views(state),
            Publish(
                snapshot=self.snapshot(),
                decisions=state.taken_decisions(),
                object_ids=object_ids,
                metrics=self._snapshots.metrics(state),
            ),
        ]

    def _poses_corrected(self, event: PosesCorrected) -> list[Effect]:
        """Set corrected submap poses. Data stay in the odometry frame; the correction is applied on output."""
        effects = place_submaps(self._state, event, self._config, merges=not self._tracker.is_told)
        keep_room(self._state)
        # The decisions are published with the next keyframe.
        return [*effects, *drop_unused_views(self._state), Publish(snapshot=self.snapshot(), decisions=())]

    def _source_ended(self) -> list[Effect]:
        state = self._state
        effects = [*end_tracks(state, self._config, merges=not self._tracker.is_told), *end_elsewhere(state)]
        state.absorbed, state.joins = {}, {}  # no track can be split off or parted any more
        return [*effects, *self._conclude((), is_final=True)]

    def snapshot(self) -> MapSnapshot:
        """Return the map as it is now."""
        return self._snapshots.snapshot(self._state)

    def prior(self) -> MapPrior | None:
        """Return the map prior for perception, in the odometry frame (without corrections); None before a keyframe.

        It has the space and the objects seen since the last jump of the odometry, across submap borders.
        """
        return self._snapshots.prior(self._state)

    @property
    def submaps(self) -> tuple[SubmapState, ...]:
        """The submaps, the last of which is open."""
        return self._state.submaps.states

    @property
    def loops(self) -> tuple[Loop, ...]:
        """What searches for loops gave, believed or not."""
        return self._state.loops

    @property
    def graph(self) -> PoseGraphRecord | None:
        """The pose graph as it was solved last; None before the first loop."""
        return self._state.graph

    @property
    def searches(self) -> tuple[SearchLoops, ...]:
        """The searches for loops that have not been answered yet."""
        return self._state.searches

    def view_names(self) -> set[str]:
        """Return the names of the views that the tracks have, or that a later split could restore."""
        return self._state.view_names()

    def keep_far_arrays(self, keep: Keep) -> None:
        """Have `keep` hold what no keyframe is about any more, compressed, e.g. on the disk; otherwise memory does."""
        self._state.derived.warm.keep = keep

    def state(self) -> dict[str, object]:
        """Return the complete state by name, from which `from_state` can resume; later events do not change it."""
        return self._state.parts()

    @classmethod
    def from_state(cls, config: MappingConfig, state: Mapping[str, Any]) -> MapperCore:
        """Return a core that resumes from what `state` returned.

        Raises:
            ValueError: the state was written by another version.
        """
        core = cls(config)
        core._state = MapState.of_parts(state, _new_map(config))
        return core

    def going_on_after(self, later: MapperCore, lost_views: Collection[str]) -> MapperCore:
        """Return a core with this earlier map, to continue after the run was rewound from the `later` core to it.

        Ids of objects, job tickets and revisions continue from those of `later`, so that no number is used twice.
        The pixels of `lost_views` no longer exist; these views are removed.
        """
        core = MapperCore.from_state(self._config, self.state())
        core._state.going_on_after(later._state, lost_views)
        return core


def _new_map(config: MappingConfig) -> MapState:
    return MapState(submaps=first_submap(config.lattice.space_m))
