"""The core of the mapper: every decision about the map, as a function of the events alone.

`MapperCore.handle(event)` is synchronous: no I/O, no clock, no randomness. The same events in the same order give the
same map, to the byte. What happens in a keyframe is listed in `_keyframe`; each step is a module of its own.

Jumps of the stamps and of the odometry: what they end.

The first and the last step of a keyframe: the state moves on to it, and the map learns what space it saw.

Ends of submaps, and searches for loops: asked for then, answered later; the answers are kept, believed or not.
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
from hickory_stream.geometry import portable
from hickory_stream.mapping.entities.observed_space import floor_change
from hickory_stream.mapping.entities.submaps import (
    false_floor,
    first_submap,
    interrupted,
    looking_at,
    put_far_away,
    surveyed,
    torn,
    with_keyframe,
    with_registration,
    with_seen,
)
from hickory_stream.mapping.invariants import validate
from hickory_stream.mapping.map_state import MapState, PendingFeatures
from hickory_stream.mapping.rules.space_agreement import agreed_after
from hickory_stream.mapping.snapshots import Snapshots
from hickory_stream.mapping.steps.ageing import age_tracks, end_tracks, keep_room, settle
from hickory_stream.mapping.steps.endings import rest_tracks
from hickory_stream.mapping.steps.moved_submaps import end_elsewhere, place_submaps, recognise
from hickory_stream.mapping.steps.shapes import end_shape, request_shapes
from hickory_stream.mapping.steps.tracker import Tracker, moved_out, split_tracks
from hickory_stream.mapping.steps.views import drop_unused_views, judge_views, propose_views

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from hickory_stream.geometry.lazy_arrays import Keep
    from hickory_stream.mapping.config import MappingConfig
    from hickory_stream.mapping.entities.submaps import SubmapConfig, SubmapState
    from hickory_stream.mapping.steps.tracker import Associator
    from hickory_stream.records import Loop, MapPrior, MapSnapshot, PoseGraphRecord


logger = logging.getLogger(__name__)


def time_jumped(state: MapState, event: TimeJumped) -> None:
    """Handle a jump of the stamps: the core's own clock does not advance across it."""
    state.stamp_ns = None
    state.submaps = interrupted(state.submaps)
    state.decide("time_jump", None, f"{event.kind}: stamps jumped from {event.from_ns} to {event.to_ns}")


def pose_jumped(state: MapState, event: PoseJumped, config: MappingConfig) -> None:
    """Close the submap. Later poses are in the same world frame, so that its objects can be re-identified.

    The observed space starts empty again, and an object is not checked against it until it has been seen again: an
    error of a few centimetres in the jump is enough to see through an object, or to place it inside a wall.
    """
    distance_m = portable.norm(event.after_from_before[:3, 3])
    settle(state, config)
    state.submaps = torn(state.submaps)
    state.split_candidates = {}
    text = f"the odometry jumped by {distance_m:.2f} m: submap {state.submaps.open_id} begins"
    state.decide("pose_jump", None, text)


def note_registration(state: MapState, event: KeyframeRegistered) -> None:
    """Keep how sure the pose of the keyframe to come is, for the pose graph."""
    state.submaps = with_registration(state.submaps, event)


def begin_keyframe(state: MapState, event: FrameObserved, config: MappingConfig) -> None:
    """Move the clock, the revision and the submaps on to a keyframe.

    Raises:
        ValueError: features of the last keyframe are still pending.
    """
    if state.pending is not None:
        raise ValueError(f"frame {event.frame_index} came while features of {state.pending.frame_index} are pending")
    state.revision += 1
    state.advance_clock(event.stamp_ns)
    warm = state.derived.warm
    state.submaps = looking_at(with_keyframe(state.submaps, event, config.submaps), event.space, warm.keep)
    rest_tracks(state, warm.follow(state.tracks, sight=state.sight, revision=state.revision))
    for rejected in event.rejected:
        state.decide("reject", None, f"mask {rejected.box_px}: {rejected.reason}")


def see_space(state: MapState, event: FrameObserved) -> None:
    """Add the keyframe's observations of free space, structure and floor to the map."""
    seen_m = event.space.floor_z_m
    changed = floor_change(state.submaps.space, seen_m, false_floor(state.submaps, seen_m))
    if changed is not None:
        state.decide("floor", None, changed)
    state.submaps = with_seen(state.submaps, event.space, state.derived.warm.keep)


def end_submap(
    state: MapState, open_id: int | None, snapshot: Callable[[], MapSnapshot], config: SubmapConfig
) -> list[SearchLoops]:
    """Let a submap that has ended count against those before it, and return the search for its loops.

    `open_id` is the one that was open, None: the one that still is. There is no search where it saw no surface, or
    none is before it.
    """
    now_id = state.submaps.open_id
    if open_id == now_id:
        return []
    submap_id = now_id if open_id is None else open_id
    state.submaps = agreed_after(state.submaps, submap_id)
    put_far_away(state.submaps, state.derived.warm.keep)
    submaps = state.submaps.states[: submap_id + 1]
    if not config.searches_loops or submap_id == 0 or len(submaps[-1].surface) == 0:
        return []
    search = SearchLoops(
        submap_id=submap_id,
        due_ns=(state.stamp_ns or 0) + int(config.loop_latency_s * 1e9),
        submaps=tuple(surveyed(submap) for submap in submaps),
        loops=state.loops,
        snapshot=snapshot(),
    )
    state.searches = (*state.searches, search)
    return [search]


def end_search(state: MapState, event: LoopsSearched) -> None:
    """Keep what a search found.

    Raises:
        ValueError: it was not asked for.
    """
    if event.submap_id not in {search.submap_id for search in state.searches}:
        raise ValueError(f"loops of submap {event.submap_id} were not asked for")
    state.searches = tuple(search for search in state.searches if search.submap_id != event.submap_id)
    state.loops = (*state.loops, *event.loops)
    for loop in event.loops:
        way = "their surfaces" if loop.method == "surface" else "their objects"
        said = "may be a loop" if loop.reason is None else f"is no loop: {loop.reason}"
        text = f"submap {loop.later} in {loop.earlier}, by {way}, {loop.score:.0%} of the surface agrees: {said}"
        state.decide("loop", None, text)


class MapperCore:
    """Holds the map; only `handle` changes it.

    `associator` replaces the data association by boxes and points (see `Tracker`); a core that is restored from a
    saved state has none.
    """

    def __init__(self, config: MappingConfig, associator: Associator | None = None) -> None:
        self._config = config
        self._tracker = Tracker(config, associator)
        self._snapshots = Snapshots(config.voxels.object_m)
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
        sightings = moved_out(state, sightings, promoted)
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
    return MapState(submaps=first_submap(config.voxels.space_m))
