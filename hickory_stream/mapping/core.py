"""The mapper's core: every decision about the map, as a function of the events alone.

`MapperCore.handle(event)` has no I/O, clock or randomness: equal events in equal order give an equal map, to the byte.
"""

import logging
from collections.abc import Collection, Mapping
from typing import Any, assert_never

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
from hickory_stream.geometry.lazy_arrays import Keep
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.submaps import SubmapState, first_submap, interrupted, with_registration
from hickory_stream.mapping.invariants import validate
from hickory_stream.mapping.map_state import MapState, PendingFeatures
from hickory_stream.mapping.snapshots import Snapshots
from hickory_stream.mapping.steps.ageing import age_tracks, end_tracks
from hickory_stream.mapping.steps.moved_submaps import end_elsewhere, place_submaps, recognise
from hickory_stream.mapping.steps.shapes import end_shape, request_shapes
from hickory_stream.mapping.steps.submaps import begin_keyframe, end_search, end_submap, jump, see_space
from hickory_stream.mapping.steps.tracker import Associator, Tracker, moved_out, split_tracks
from hickory_stream.mapping.steps.views import drop_unused_views, judge_views, propose_views
from hickory_stream.records import Loop, MapPrior, MapSnapshot, PoseGraphRecord

logger = logging.getLogger(__name__)


class MapperCore:
    """Holds the map; only `handle` changes it.

    `associator` replaces the data association (see `Tracker`); a core restored from a saved state has none.
    """

    def __init__(self, config: MappingConfig, associator: Associator | None = None) -> None:
        self._config = config
        self._tracker = Tracker(config, associator)
        self._snapshots = Snapshots(config.voxels.object_m)
        self._state = _new_map(config)

    def handle(self, event: Event) -> list[Effect]:
        """Apply an event and return the effects that the caller has to carry out.

        Raises:
            ValueError: the event is not expected now, e.g. features of a keyframe that is not pending.
            InvariantError: the state breaks an invariant; checked only with `--debug`.
        """
        effects = self._handled(event)
        if logger.isEnabledFor(logging.DEBUG):
            validate(self._state)
        return effects

    def validate(self) -> None:
        """Check the invariants of the map's state; raises `InvariantError`."""
        validate(self._state)

    def _handled(self, event: Event) -> list[Effect]:
        state = self._state
        match event:
            case FrameObserved():
                return self._keyframe(event)
            case FeaturesReady():
                return self._features_ready(event)
            case ShapeReady() | ShapeFailed():
                end_shape(state, event)
            case TimeJumped():
                state.stamp_ns, state.submaps = None, interrupted(state.submaps)
                state.decide("time_jump", None, f"{event.kind}: stamps jumped from {event.from_ns} to {event.to_ns}")
            case PoseJumped():
                open_id = state.submaps.open_id
                jump(state, event)
                return [*end_submap(state, open_id, self.snapshot, self._config.submaps)]
            case PosesCorrected():
                effects = place_submaps(state, event, self._config, merges=not self._tracker.is_external)
                # The decisions are published with the next keyframe.
                return [*effects, *drop_unused_views(state), Publish(snapshot=self.snapshot(), decisions=())]
            case LoopsSearched():
                end_search(state, event)
            case WayEnded():
                return [*end_submap(state, None, self.snapshot, self._config.submaps)]
            case KeyframeRegistered():
                state.submaps = with_registration(state.submaps, event)
            case KeyframeKeptOut():
                state.decide("keep_out", None, f"frame {event.frame_index} is kept out: {event.reason}")
            case SourceEnded():
                effects = end_tracks(state, self._config, merges=not self._tracker.is_external)
                effects += end_elsewhere(state, self._config, merges=not self._tracker.is_external)
                state.absorbed, state.joins = {}, {}  # no later split or unmerge
                return [*effects, *self._conclude((), is_final=True)]
            case _:
                assert_never(event)
        return []

    def _keyframe(self, event: FrameObserved) -> list[Effect]:
        state, config, tracker = self._state, self._config, self._tracker
        open_id = state.submaps.open_id
        begin_keyframe(state, event, config)
        effects: list[Effect] = [*end_submap(state, open_id, self.snapshot, config.submaps)]
        effects += recognise(state, event, config)
        sightings = tracker.track(state, event)
        seen_ids = {sighting.track_id for sighting in sightings}
        promoted = split_tracks(state, event, seen_ids, config)
        sightings = moved_out(state, sightings, promoted)
        changed_ids = {*(sighting.track_id for sighting in sightings), *promoted, *promoted.values()}
        effects += tracker.merge_tracks(state, changed_ids)
        state.stirred |= changed_ids
        effects += age_tracks(state, event, config, merges=not tracker.is_external)
        see_space(state, event)
        candidates, keeps = propose_views(state, event, sightings, config.views)
        effects += keeps
        state.num_masks += len(event.observations)
        object_ids = tuple(state.current_id(sighting.track_id) for sighting in sightings)
        if not candidates:
            return [*effects, *self._conclude(object_ids)]
        state.num_features += len(candidates)
        state.pending = PendingFeatures(frame_index=event.frame_index, candidates=candidates, object_ids=object_ids)
        return [*effects, ComputeFeatures(frame_index=event.frame_index, observation_indices=tuple(sorted(candidates)))]

    def _features_ready(self, event: FeaturesReady) -> list[Effect]:
        state, pending = self._state, self._state.pending
        if pending is None or pending.frame_index != event.frame_index:
            raise ValueError(f"features of frame {event.frame_index} were not asked for")
        state.pending = None
        return [*judge_views(state, pending, event, self._config.views), *self._conclude(pending.object_ids)]

    def _conclude(self, object_ids: tuple[int | None, ...], *, is_final: bool = False) -> list[Effect]:
        state = self._state
        effects = [*request_shapes(state, self._config, is_final=is_final), *drop_unused_views(state)]
        decisions, metrics = state.taken_decisions(), self._snapshots.metrics(state)
        published = Publish(snapshot=self.snapshot(), decisions=decisions, object_ids=object_ids, metrics=metrics)
        return [*effects, published]

    def snapshot(self) -> MapSnapshot:
        """Return the present map."""
        return self._snapshots.snapshot(self._state)

    def prior(self) -> MapPrior | None:
        """Return the objects and the space seen since the last jump of the odometry, in its frame; None at first."""
        return self._snapshots.prior(self._state)

    @property
    def submaps(self) -> tuple[SubmapState, ...]:
        """The submaps, the last of which is open."""
        return self._state.submaps.states

    @property
    def loops(self) -> tuple[Loop, ...]:
        """All results of the searches for loops, believed or not."""
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
        """Let `keep` hold the compressed arrays of tracks that were not seen recently, e.g. on the disk."""
        self._state.derived.warm.keep = keep

    def state(self) -> dict[str, object]:
        """Return the complete state by name, from which `from_state` can resume; later events do not change it."""
        return self._state.parts()

    @classmethod
    def from_state(cls, config: MappingConfig, state: Mapping[str, Any]) -> "MapperCore":
        """Return a core that resumes from a result of `state`; raises `ValueError` for another version's."""
        core = cls(config)
        core._state = MapState.of_parts(state, _new_map(config))
        return core

    def going_on_after(self, later: "MapperCore", lost_views: Collection[str]) -> "MapperCore":
        """Return a core with this earlier map, to continue after the run was rewound from the `later` core to it.

        Ids, tickets and revisions continue from `later`; views named in `lost_views` have no pixels and are removed.
        """
        core = MapperCore.from_state(self._config, self.state())
        core._state.going_on_after(later._state, lost_views)
        return core


def _new_map(config: MappingConfig) -> MapState:
    return MapState(submaps=first_submap(config.voxels.space_m))
