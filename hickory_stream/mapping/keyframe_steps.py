"""The first and the last step of a keyframe: the state moves on to it, and the map learns what space it saw."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.mapping.far_away import rest_tracks
from hickory_stream.mapping.observed_space import floor_change
from hickory_stream.mapping.submaps import false_floor, looking_at, with_keyframe, with_registration, with_seen

if TYPE_CHECKING:
    from hickory_stream.events import FrameObserved, KeyframeRegistered
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig


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
