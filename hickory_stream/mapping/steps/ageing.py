"""Ageing of tracks: executes the life cycle table (`lifecycle.LIFE_CYCLE`) with its guards and effects.

The observed space, the tracks around it and its time out of sight judge a track. So of the tracks out of sight only
changed ones, their neighbours and timed-out ones are judged again; only the filtered height of the floor reaches others
late. A generated shape whose invented parts a keyframe sees to be free is requested again.
"""

import heapq
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from hickory_stream.events import Effect, FrameObserved
from hickory_stream.geometry.superquadric_surface import display_mesh
from hickory_stream.geometry.voxels import contains, keys_of_points, layers_of_keys
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.cloud import is_packed, pack_part
from hickory_stream.mapping.entities.observed_space import SpaceState, share_in, window_of
from hickory_stream.mapping.entities.submaps import space_around
from hickory_stream.mapping.entities.track import Track, is_object, sketched
from hickory_stream.mapping.entities.track_table import REACH_M, Mark
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules.fixtures import judged
from hickory_stream.mapping.rules.lifecycle import (
    Guard,
    LifecycleConfig,
    LifeEvent,
    TrackEffect,
    Transition,
    counted_ns,
    is_sure,
    transition,
)
from hickory_stream.mapping.rules.support_relations import MEET_M
from hickory_stream.mapping.steps.endings import drop, unite
from hickory_stream.records import ObjectShape, Phase

_ROUNDING_NS = 2
# The kind of a track is judged again when its points or sightings have changed by this share, and at the end.
_JUDGED_GROWTH = 0.5
# A keyframe that observes at least this share of a track's voxels free sees through it.
_PHANTOM_SHARE = 0.7
# A generated shape of which a keyframe sees this share to be free is renewed, if views have come since its request.
_REFUTED_SHARE = 0.1


class Concerned:
    """The ids of the tracks to judge at a keyframe, ascending; judgements add others on the way.

    Tracks that change, and their neighbours, are judged in the next keyframe as well (`state.stirred`).
    """

    def __init__(self, state: MapState, event: FrameObserved, config: LifecycleConfig) -> None:
        self._state = state
        self._stirred: set[int] = set()
        sight = _sight_of(event, state.submaps.space.voxel_m)
        ids = {*state.stirred, *_timed_out(state, config)}
        # What was seen in the keyframe before has become known since its tracks were judged.
        for bounds in (sight, state.sight):
            if bounds is not None:
                ids |= {track.id for track in state.tracks.touching(bounds, REACH_M)}
        self._waiting, self._named = sorted(ids), ids
        state.sight, state.judged_ns, state.stirred = sight, state.clock_ns, self._stirred

    def __iter__(self) -> Iterator[int]:
        while self._waiting:
            track_id = heapq.heappop(self._waiting)
            if track_id in self._state.tracks:
                before, mark = self._state.tracks[track_id], self._state.tracks.now
                yield track_id
                self._stir(track_id, before, mark)

    def _stir(self, track_id: int, before: Track, mark: Mark) -> None:
        tracks = self._state.tracks
        changed_ids = tracks.changed_since(mark)
        moved = [tracks[i] for i in changed_ids if i in tracks] + [before] * (track_id in changed_ids)
        for other in {other.id for track in moved for other in tracks.touching(track.bounds, REACH_M)}:
            self._stirred.add(other)
            if other > track_id and other not in self._named:
                self._named.add(other)
                heapq.heappush(self._waiting, other)


def _timed_out(state: MapState, config: LifecycleConfig) -> Iterator[int]:
    # The tracks that were not seen for one of the configured times, since the last keyframe's judgement.
    for limit_s in (config.tentative_s, config.dormant_s, config.archive_s):
        limit_ns = int(limit_s * 1e9)
        after_ns, until_ns = state.judged_ns - limit_ns - _ROUNDING_NS, state.clock_ns - limit_ns + _ROUNDING_NS
        yield from state.tracks.last_seen(after_ns, until_ns)


def _sight_of(event: FrameObserved, voxel_m: float) -> NDArray[np.float32] | None:
    # Bounds (2, 3) of a keyframe's view, None if it is empty.
    keys = (event.space.free_keys, event.space.structure_keys, event.space.surface_keys)
    bounds = []
    if (window := window_of(*keys)) is not None:
        heights = np.concatenate([[layers.min(), layers.max()] for layers in map(layers_of_keys, keys) if len(layers)])
        low, high = (*window.low, heights.min()), (*window.high, heights.max() + 1)
        bounds.append(np.array([low, high], dtype=np.float64) * voxel_m)
    for observation in event.observations:
        corners = observation.box.corners_world()
        bounds.append(np.stack([corners.min(axis=0), corners.max(axis=0)]))
    if not bounds:
        return None
    both = np.array(bounds)
    return np.stack([both[:, 0].min(axis=0), both[:, 1].max(axis=0)]).astype(np.float32)


# Parts of which less was made up say nothing of the generator.
_MADE_UP = 0.05
# This share of the way from a part's centre to its surface; a fit may reach beyond the mesh by less than the rest.
_INWARDS = 0.75


def _with_shape_checked(state: MapState, track: Track, free_keys: NDArray[np.int64], config: MappingConfig) -> Track:
    # A contradicted shape is requested again, once: only with other views than those of the last request.
    shape, asked = track.shape, track.shape_state
    if shape is None or not shape.is_generated or asked.open_ticket is not None or not asked.asked_views:
        return track
    if set(track.names_of_views) == set(asked.asked_views):
        return track
    places = _invented_points(shape)
    free = contains(free_keys, keys_of_points(places, config.voxels.space_m)).mean() if len(places) else 0.0
    if len(places) == 0 or free < _REFUTED_SHARE:
        return track
    state.decide("shape", track.id, f"{free:.2f} of its generated shape was seen to be free: to be asked for again")
    # All views and all surface count as new.
    return replace(track, shape_state=replace(asked, asked_views=(), asked_points=0, asked_score=0.0))


def _invented_points(shape: ObjectShape) -> NDArray[np.float32]:
    # (N, 3) points within the invented parts of a shape. An envelope is larger than its object on purpose.
    if shape.fit_kind == "envelope":
        return np.empty((0, 3), np.float32)
    places = [np.empty((0, 3), np.float32)]
    for i in np.flatnonzero(shape.seen_share < 1 - _MADE_UP):
        center = shape.fitted.world_from_local[i, :3, 3]
        surface, _ = display_mesh(shape.fitted, int(i))
        places.append((center + _INWARDS * (surface - center)).astype(np.float32))
    return np.concatenate(places)


def age_tracks(state: MapState, event: FrameObserved, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Age the tracks that a keyframe concerns; `merges`: an unsupported track is merged into its neighbour."""
    effects: list[Effect] = []
    for track_id in Concerned(state, event, config.lifecycle):
        case = TrackTransition(state, track_id, config, free_keys=event.space.free_keys, merges=merges)
        effects += [*case.happens(LifeEvent.JUDGED), *case.happens(LifeEvent.AGED)]
        if track_id in state.tracks:
            case.judge(_JUDGED_GROWTH)
            track = sketched(state.tracks[track_id])
            state.tracks[track_id] = _with_shape_checked(state, track, event.space.free_keys, config)
    return effects


def end_tracks(state: MapState, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Drop the tracks that were not confirmed by the end, and merge unsupported ones."""
    effects: list[Effect] = []
    for track_id in sorted(state.tracks):
        was_packed = track_id in state.tracks and is_packed(state.tracks[track_id].cloud)
        case = TrackTransition(state, track_id, config, merges=merges)
        # Its surroundings may have changed since its points have.
        case.judge()
        effects += case.happens(LifeEvent.SOURCE_ENDED)
        if was_packed and (track := state.tracks.get(track_id)) is not None:
            pack_part(track.solid, track.cloud, state.derived.warm.keep)
    return effects


def is_seen_through(track: Track, free_keys: NDArray[np.int64], config: MappingConfig) -> bool:
    """Return whether a keyframe whose rays traversed the sorted voxels `free_keys` saw through a track."""
    return share_in(free_keys, track.cloud.points, config.voxels.space_m) >= _PHANTOM_SHARE


class TrackTransition:
    """A track and the values that guards test; each value is computed at most once, when it is needed."""

    def __init__(
        self,
        state: MapState,
        track_id: int,
        config: MappingConfig,
        *,
        free_keys: NDArray[np.int64] | None = None,
        merges: bool = False,
    ) -> None:
        self.state = state
        self.config = config
        self._track_id = track_id
        self._free_keys = free_keys
        self._merges = merges

    @property
    def track(self) -> Track:
        """The present track."""
        return self.state.tracks[self._track_id]

    def happens(self, event: LifeEvent) -> list[Effect]:
        """Apply an event to the track, if it still exists, by the row of the table."""
        if self._track_id not in self.state.tracks:
            return []
        row = transition(self.track.phase, event, lambda guard: GUARDS[guard](self))
        if row is None:
            return []
        done = [effect for track_effect in row.effects for effect in EFFECTS[track_effect](self, row)]
        if isinstance(row.to, Phase) and row.to is not self.track.phase:
            track = self.track
            self.state.decide("phase", track.id, f"{track.phase} -> {row.to} after {track.sightings} sightings")
            self.change(replace(track, phase=row.to))
        return done

    def judge(self, growth: float = 0.0) -> None:
        """Judge whether the track is an object or a fixture, if it has changed by more than a share since.

        Without a share, which is at the end, the reason is given also for a kind that stays.
        """
        track = self.track
        has_grown = abs(len(track.solid) - track.judged_points) > growth * track.judged_points
        was_seen = track.sightings - track.judged_sightings > growth * track.judged_sightings
        if not self.state.is_judged(track) or not (has_grown or was_seen or growth == 0):
            return
        now, why = judged(track, self.space)
        if growth == 0 or now.kind is not track.kind:
            self.state.decide("kind", track.id, f"{now.kind} after {track.sightings} sightings: {why}")
        self.change(now)

    def change(self, track: Track) -> None:
        """Replace the track by a new version of it."""
        self.state.tracks[self._track_id] = track

    def is_unseen_for(self, limit_s: float) -> bool:
        """Return whether the track was not seen for longer than this."""
        return (self.state.clock_ns - self.track.seen_clock_ns) / 1e9 > limit_s

    @cached_property
    def space(self) -> SpaceState:
        """The observed space around the track, as far as any check looks."""
        return space_around(self.state.submaps, self.track.bounds, REACH_M)

    @cached_property
    def attachment(self) -> int | None:
        """The id of the track from which this one hangs; None if it is supported, or no track is near."""
        if not self._merges:
            return None
        beside = self.state.tracks.touching(self.track.bounds, MEET_M)
        # A fixture hangs from the room; and what a piece of a wall seems to hold hangs from that.
        others = (o for o in beside if is_object(o) and o.kind is self.track.kind and self.state.is_judged(o))
        support = self.state.support_graph(self.space).hangs_from(self.track, others)
        return None if support is None else support.by

    def is_seen_through(self) -> bool:
        """Return whether the keyframe did not observe the track, but free space at its position."""
        if self.track.seen_clock_ns == self.state.clock_ns or self._free_keys is None:
            return False
        return is_seen_through(self.track, self._free_keys, self.config)


def _doubt(case: TrackTransition, _: Transition) -> list[Effect]:
    track = case.track
    passed_ns = counted_ns(case.state.keyframe_ns)
    left_ns = max(track.observed_ns - passed_ns, 0)
    case.change(replace(track, seen_through_ns=track.seen_through_ns + passed_ns, observed_ns=left_ns))
    return []


def _drop(case: TrackTransition, row: Transition) -> list[Effect]:
    assert row.cause is not None
    return drop(case.state, case.track, row.cause)


def _merge(case: TrackTransition, _: Transition) -> list[Effect]:
    assert case.attachment is not None
    reason = "unsupported but for this one, which it touches"
    return unite(case.state, case.attachment, case.track.id, reason, case.config)


# Guards on two tracks that are merged are tested in `rules.merging`.
GUARDS: dict[Guard, Callable[[TrackTransition], bool]] = {
    Guard.SEEN_THROUGH: TrackTransition.is_seen_through,
    Guard.PHANTOM: lambda case: case.track.seen_through_ns >= 1e9 * case.config.lifecycle.phantom_s,
    Guard.SURE: lambda case: is_sure(case.track, case.config.lifecycle),
    Guard.UNCONFIRMED: lambda case: case.is_unseen_for(case.config.lifecycle.tentative_s),
    Guard.DOUBTED: lambda case: case.track.seen_through_ns > 0,
    Guard.UNSEEN: lambda case: case.is_unseen_for(case.config.lifecycle.dormant_s),
    Guard.LONG_UNSEEN: lambda case: case.is_unseen_for(case.config.lifecycle.archive_s),
    Guard.KNOWN_HERE: lambda case: case.state.is_judged(case.track),
    Guard.UNSUPPORTED: lambda case: case.attachment is not None,
}

EFFECTS: dict[TrackEffect, Callable[[TrackTransition, Transition], list[Effect]]] = {
    TrackEffect.DOUBT: _doubt,
    TrackEffect.DROP: _drop,
    TrackEffect.MERGE: _merge,
}
