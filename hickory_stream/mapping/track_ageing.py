"""What becomes of the tracks as time passes: confirmed, resting, held against the observed space, dropped."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hickory_stream.mapping.cloud import without
from hickory_stream.mapping.existence import doubted
from hickory_stream.mapping.lifecycle import aged, next_phase
from hickory_stream.mapping.observed_space import known_no_object, share_in
from hickory_stream.mapping.structure_checks import is_seen_through, points_in_wall, why_structure
from hickory_stream.mapping.submaps import with_structure
from hickory_stream.mapping.track import sketched, with_cloud
from hickory_stream.mapping.track_endings import drop, unite
from hickory_stream.mapping.unsupported import attachment_of
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from hickory_stream.events import Effect, FrameObserved
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.track import Track

_UNSUPPORTED = "unsupported but for this one, which it touches"


def age_tracks(state: MapState, event: FrameObserved, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Let every track age by a keyframe; `merges`: one that is unsupported becomes a part of what it is attached to."""
    effects: list[Effect] = []
    no_object = known_no_object(state.submaps.space)
    for track_id in sorted(state.tracks):
        track = state.tracks[track_id]
        is_judged = state.is_judged(track)
        reason = why_structure(track, state.submaps.space, state.clock_ns, config) if is_judged else None
        if reason is not None:
            state.submaps = with_structure(state.submaps, track.solid.points)
            no_object = known_no_object(state.submaps.space)
            effects += drop(state, track, "structure", reason)
            continue
        lies_in = share_in(no_object, track.solid.points, state.submaps.space.voxel_m) if is_judged else 0.0
        if lies_in > config.lifecycle.structure_share:
            effects += drop(state, track, "in structure", "a piece of what was found to be structure")
            continue
        is_out_of_sight = is_judged and track.seen_clock_ns != state.clock_ns
        if is_out_of_sight and is_seen_through(track, event.space.free_keys, config):
            track = replace(track, seen_through=track.seen_through + 1, existence=doubted(track.existence))
        phase = next_phase(track, state.clock_ns, config.lifecycle)
        if phase is None:
            effects += drop(state, track, "looked through" if track.seen_through else "never confirmed")
            continue
        if is_judged and phase is Phase.DORMANT and track.phase is Phase.ACTIVE:
            if merges and (host := _attachment_of(state, track, config)) is not None:
                effects += unite(state, host.id, track_id, _UNSUPPORTED, config)
                continue
            track = _without_wall(state, track, config)
        if phase is not track.phase:
            state.decide("phase", track_id, f"{track.phase} -> {phase} after {track.sightings} sightings")
        state.tracks[track_id] = sketched(aged(track, phase), config.track)
    return effects


def settle(state: MapState, config: MappingConfig) -> None:
    """Remove the points of tracks that lie in structure, before the observed space is reset."""
    for track_id in sorted(state.tracks):
        if state.is_judged(state.tracks[track_id]):
            state.tracks[track_id] = _without_wall(state, state.tracks[track_id], config)


def end_tracks(state: MapState, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Drop what was never confirmed by the end, and merge what is unsupported."""
    effects: list[Effect] = []
    settle(state, config)
    for track_id in sorted(state.tracks):
        track = state.tracks[track_id]
        if track.phase is Phase.TENTATIVE:
            effects += drop(state, track, "never confirmed")
        elif merges and state.is_judged(track) and (host := _attachment_of(state, track, config)) is not None:
            effects += unite(state, host.id, track_id, _UNSUPPORTED, config)
    return effects


def _attachment_of(state: MapState, track: Track, config: MappingConfig) -> Track | None:
    """Return the track that an unsupported track is attached to; None if it is supported, or near nothing."""
    others = (o for o in state.tracks.values() if o.phase is not Phase.TENTATIVE and state.is_judged(o))
    return attachment_of(track, others, state.submaps.space, config.unsupported)


def _without_wall(state: MapState, track: Track, config: MappingConfig) -> Track:
    """Return a track without its points in structure, if these are more than a narrow strip along a wall."""
    in_wall = points_in_wall(track, state.submaps.space, config)
    if in_wall is None:
        return track
    state.decide("trim", track.id, f"{in_wall.mean():.0%} of its points are those of a wall")
    return with_cloud(track, without(track.cloud, in_wall), track.sightings, config.lattice.points_m)
