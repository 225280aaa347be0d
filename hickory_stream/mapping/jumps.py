"""Jumps of the stamps and of the odometry: what they end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.geometry import portable
from hickory_stream.mapping.submaps import interrupted, torn
from hickory_stream.mapping.track_ageing import settle

if TYPE_CHECKING:
    from hickory_stream.events import PoseJumped, TimeJumped
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig


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
