"""Ageing of tracks: executes the life cycle table (`lifecycle.LIFE_CYCLE`) on a state, with its guards and effects."""

from __future__ import annotations

from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.mapping.claims import with_claims_checked
from hickory_stream.mapping.cloud import without
from hickory_stream.mapping.cold_clouds import is_packed, pack_part
from hickory_stream.mapping.concerned_tracks import Concerned
from hickory_stream.mapping.existence import doubted
from hickory_stream.mapping.lifecycle import Guard, LifeEvent, TrackEffect, is_sure, transition
from hickory_stream.mapping.observed_space import share_in
from hickory_stream.mapping.structure_checks import is_seen_through, points_in_wall, why_structure
from hickory_stream.mapping.submaps import space_around
from hickory_stream.mapping.track import is_object, sketched, with_cloud
from hickory_stream.mapping.track_endings import cancelled, drop, unite
from hickory_stream.mapping.track_table import REACH_M
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.events import Effect, FrameObserved
    from hickory_stream.mapping.lifecycle import Transition
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.observed_space import SpaceState
    from hickory_stream.mapping.track import Track


def age_tracks(state: MapState, event: FrameObserved, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Age the tracks that a keyframe concerns.

    `merges`: an unsupported track is merged into the one that it is attached to.
    """
    effects: list[Effect] = []
    keep_room(state)  # tracks may have been merged
    for track_id in Concerned(state, event, config.lifecycle):
        case = Case(state, track_id, config, free_keys=event.space.free_keys, merges=merges)
        effects += [*case.happens(LifeEvent.JUDGED), *case.happens(LifeEvent.AGED)]
        if track_id in state.tracks:
            track = sketched(state.tracks[track_id], config.track)
            state.tracks[track_id] = with_claims_checked(state, track, event.space.free_keys, config)
    keep_room(state)
    return effects


def keep_room(state: MapState) -> None:
    """Update the voxels of the observed space that belong to tracks that are part of the room."""
    state.submaps = state.derived.room.kept(state.submaps, state.tracks)


def settle(state: MapState, config: MappingConfig) -> None:
    """Remove the points of tracks that lie in structure, before the observed space is reset."""
    for track_id in sorted(state.tracks):
        with _as_warm_as_before(state, track_id):
            Case(state, track_id, config).happens(LifeEvent.SPACE_FORGOTTEN)


def end_tracks(state: MapState, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Drop the tracks that were not confirmed by the end, and merge unsupported ones."""
    settle(state, config)
    effects: list[Effect] = []
    for track_id in sorted(state.tracks):
        with _as_warm_as_before(state, track_id):
            effects += Case(state, track_id, config, merges=merges).happens(LifeEvent.SOURCE_ENDED)
    return effects


@contextmanager
def _as_warm_as_before(state: MapState, track_id: int) -> Iterator[None]:
    """Compress the cloud of a track again that was compressed before the block."""
    track = state.tracks.get(track_id)
    was_packed = track is not None and is_packed(track.cloud)
    yield
    if was_packed and (track := state.tracks.get(track_id)) is not None:
        pack_part(track.solid, track.cloud, state.derived.warm.keep)


class Case:
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
        """The track as it is now."""
        return self.state.tracks[self._track_id]

    def happens(self, event: LifeEvent) -> list[Effect]:
        """Apply an event to the track, if it still exists: execute the row of the table that applies."""
        if self._track_id not in self.state.tracks:
            return []
        row = transition(self.track.phase, event, lambda guard: GUARDS[guard](self))
        if row is None:
            return []
        done = [effect for track_effect in row.effects for effect in EFFECTS[track_effect](self, row)]
        if isinstance(row.to, Phase) and row.to is not self.track.phase:
            track = self.track
            after = f"after {track.sightings} sightings"
            if row.to is Phase.ROOM:
                text = f"set aside as part of the room {after}: {self.why_structure}"
            elif track.phase is Phase.ROOM:
                text = f"an object after all, {after}: by what was seen since it is no part of the room"
            else:
                text = f"{track.phase} -> {row.to} {after}"
            is_room = Phase.ROOM in (track.phase, row.to)
            self.state.decide("room" if is_room else "phase", track.id, text)
            self.change(replace(track, phase=row.to))
            if is_room:
                keep_room(self.state)
        return done

    def change(self, track: Track) -> None:
        """Replace the track by a new version of it."""
        self.state.tracks[self._track_id] = track

    def is_unseen_for(self, limit_s: float) -> bool:
        """Return whether the track was not seen for longer than this."""
        return (self.state.clock_ns - self.track.seen_clock_ns) / 1e9 > limit_s

    @cached_property
    def why_structure(self) -> str | None:
        """Why the track is structure; None if it may be an object."""
        return why_structure(self.track, self.space, self.state.clock_ns, self.config)

    @cached_property
    def space(self) -> SpaceState:
        """The observed space around the track, as far as any check looks."""
        return space_around(self.state.submaps, self.track.bounds, REACH_M)

    @cached_property
    def attachment(self) -> int | None:
        """The id of the track that this one hangs from; None if it is supported, or no track is near."""
        if not self._merges:
            return None
        beside = self.state.tracks.touching(self.track.bounds, self.config.unsupported.attach_m)
        others = (o for o in beside if is_object(o) and self.state.is_judged(o))
        support = self.state.support_graph(self.config, self.space).hangs_from(self.track, others)
        return None if support is None else support.by

    def is_in_room(self) -> bool:
        """Return whether most of the track lies on tracks that are part of the room."""
        space = self.space
        share = share_in(space.room, self.track.solid.points, space.voxel_m)
        return share > self.config.lifecycle.structure_share

    def is_revised(self) -> bool:
        """Return whether the track, set aside, has gained enough evidence since and is not part of the room now."""
        seen_since = self.track.existence.evidence - self.track.aside_evidence
        return seen_since >= self.config.lifecycle.revise_evidence and self.why_structure is None

    def is_seen_through(self) -> bool:
        """Return whether the keyframe did not observe the track, but free space at its position."""
        is_in_sight = self.track.seen_clock_ns == self.state.clock_ns
        return (
            not is_in_sight
            and self._free_keys is not None
            and is_seen_through(self.track, self._free_keys, self.config)
        )


def _set_aside(case: Case, _: Transition) -> list[Effect]:
    track = case.track
    effects = cancelled(track)
    shape_state = replace(track.shape_state, open_ticket=None)
    case.change(replace(track, shape_state=shape_state, aside_evidence=track.existence.evidence))
    return effects


def _doubt(case: Case, _: Transition) -> list[Effect]:
    track = case.track
    case.change(replace(track, seen_through=track.seen_through + 1, existence=doubted(track.existence)))
    return []


def _trim(case: Case, _: Transition) -> list[Effect]:
    """Remove the points in structure, if these are more than a narrow strip along a wall."""
    track = case.track
    # A few of its points may lie further away than it reaches without them.
    space = space_around(case.state.submaps, bounds_of(track.cloud.points), REACH_M)
    in_wall = points_in_wall(track, space, case.config)
    if in_wall is not None:
        case.state.decide("trim", track.id, f"{in_wall.mean():.0%} of its points are those of a wall")
        rest = without(track.cloud, in_wall)
        case.change(with_cloud(track, rest, track.sightings, case.config.lattice.points_m))
    return []


def _drop(case: Case, row: Transition) -> list[Effect]:
    assert row.cause is not None
    reasons = {"structure": case.why_structure, "in structure": "it lies on what is part of the room"}
    return drop(case.state, case.track, row.cause, reasons.get(row.cause))


def _merge(case: Case, _: Transition) -> list[Effect]:
    assert case.attachment is not None
    reason = "unsupported but for this one, which it touches"
    return unite(case.state, case.attachment, case.track.id, reason, case.config)


GUARDS: dict[Guard, Callable[[Case], bool]] = {
    Guard.IS_ROOM: lambda case: case.why_structure is not None,
    Guard.IN_ROOM: Case.is_in_room,
    Guard.REVISED: Case.is_revised,
    Guard.SEEN_THROUGH: Case.is_seen_through,
    Guard.PHANTOM: lambda case: case.track.seen_through >= case.config.lifecycle.phantom_frames,
    Guard.SURE: lambda case: is_sure(case.track, case.config.lifecycle),
    Guard.UNCONFIRMED: lambda case: case.is_unseen_for(case.config.lifecycle.tentative_s),
    Guard.DOUBTED: lambda case: case.track.seen_through > 0,
    Guard.UNSEEN: lambda case: case.is_unseen_for(case.config.lifecycle.dormant_s),
    Guard.LONG_UNSEEN: lambda case: case.is_unseen_for(case.config.lifecycle.archive_s),
    Guard.KNOWN_HERE: lambda case: case.state.is_judged(case.track),
    Guard.UNSUPPORTED: lambda case: case.attachment is not None,
}
"""The test of each guard of the table; guards on two tracks that are merged are tested in `track_merging`."""

EFFECTS: dict[TrackEffect, Callable[[Case, Transition], list[Effect]]] = {
    TrackEffect.SET_ASIDE: _set_aside,
    TrackEffect.DOUBT: _doubt,
    TrackEffect.TRIM: _trim,
    TrackEffect.DROP: _drop,
    TrackEffect.MERGE: _merge,
}
"""The function of each effect of the table."""
