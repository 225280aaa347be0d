"""Shape jobs of the tracks: requests, replacements (as ranked by `requests`) and their results."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hickory_stream.events import CancelShape, ShapeReady
from hickory_stream.mapping.entities.track_table import REACH_M
from hickory_stream.mapping.rules.shape_requests import (
    gain_of,
    increase_in_score,
    next_replacements,
    next_requests,
    predicted_s,
    shape_request,
    state_of_request,
)

if TYPE_CHECKING:
    from hickory_stream.events import Effect, ShapeFailed
    from hickory_stream.mapping.config import MappingConfig
    from hickory_stream.mapping.map_state import MapState


def request_shapes(state: MapState, mapping: MappingConfig, *, is_final: bool) -> list[Effect]:
    """Request the most urgent shapes within the budget of open jobs; at the end, all shapes that are missing."""
    config, wishes = mapping.requests, state.derived.wishes
    wishes.follow(state.tracks, state.elsewhere, config)
    num_open = wishes.num_open
    replaced = [] if is_final else next_replacements(wishes.with_job(state.tracks), state.clock_ns, config)
    if is_final:
        wanted = next_requests(state.tracks, num_open, state.clock_ns, is_final=True, config=config)
    else:
        wanted = wishes.next_wanted(state.tracks, state.clock_ns, config)
    effects = [effect for track_id in (*replaced, *wanted) for effect in _requested(state, track_id, mapping)]
    if is_final:
        missing = next_requests(state.elsewhere, num_open, state.clock_ns, is_final=True, config=config)
        effects += [effect for track_id in missing for effect in _requested(state, track_id, mapping)]
    return effects


def _requested(state: MapState, track_id: int, mapping: MappingConfig) -> list[Effect]:
    """Request the shape of a track; an open job of the track is replaced."""
    effects: list[Effect] = []
    config = mapping.requests
    tracks = state.tracks if track_id in state.tracks else state.elsewhere
    track = tracks[track_id]
    if (gone := track.shape_state.open_ticket) is not None:
        effects.append(CancelShape(ticket=gone))
        state.decide("shape", track_id, f"job {gone} is replaced: S grew by {increase_in_score(track):.3f}")
    ticket = state.next_ticket
    state.next_ticket += 1
    # A completed shape ends at the surface below. What lies below a track elsewhere is not known in its own frame.
    beside = {other.id: other for other in state.tracks.touching(track.bounds, REACH_M)}
    graph = replace(state.support_graph(), bodies=beside)
    support = graph.rests_on(track) if tracks is state.tracks else None
    due_ns = (state.stamp_ns or 0) + int(config.latency_s * 1e9)
    request = shape_request(
        track, ticket=ticket, support_z_m=None if support is None else support.height_m, due_ns=due_ns
    )
    effects.append(request)
    state.decide(
        "shape",
        track_id,
        f"job {ticket} asked for: S {increase_in_score(track):+.3f} in {predicted_s(track, config):.1f} s, "
        f"new {gain_of(track):.2f}, {len(request.views)} views",
    )
    asked = state_of_request(track, ticket, state.clock_ns, is_replacement=gone is not None)
    tracks[track_id] = replace(track, shape_state=asked)
    return effects


def _told(event: ShapeReady) -> str:
    found = f"job {event.ticket}: {len(event.shape.fitted)} superquadrics"
    return f"{found}; {event.shape.verdict}" if event.shape.verdict else found


def end_shape(state: MapState, event: ShapeReady | ShapeFailed) -> None:
    """Store the result of a shape job in its track; a result of a job that is no longer wanted is ignored."""
    tracks = state.tracks if event.object_id in state.tracks else state.elsewhere
    track = tracks.get(event.object_id)
    if track is None or track.shape_state.open_ticket != event.ticket:
        state.decide("shape", event.object_id, f"job {event.ticket} ended, but is no longer wanted")
        return
    ended = replace(track.shape_state, open_ticket=None)
    if isinstance(event, ShapeReady):
        state.decide("shape", track.id, _told(event))
        tracks[track.id] = replace(track, shape=event.shape, shape_state=replace(ended, failures=0))
    else:
        state.decide("shape", track.id, f"job {event.ticket} gave no shape: {event.reason}")
        tracks[track.id] = replace(track, shape_state=replace(ended, failures=ended.failures + 1))
