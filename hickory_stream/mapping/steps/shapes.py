"""Shape jobs of the tracks: requests, replacements and results."""

from dataclasses import replace

from hickory_stream.events import CancelShape, Effect, ShapeFailed, ShapeReady
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.track_table import REACH_M
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules import shape_requests
from hickory_stream.mapping.rules.shape_requests import increase_in_score, next_requests, predicted_s


def request_shapes(state: MapState, mapping: MappingConfig, *, is_final: bool) -> list[Effect]:
    """Request the most urgent shapes within the budget of open jobs; at the end, all missing shapes."""
    config, wishes, now_ns = mapping.requests, state.derived.wishes, state.clock_ns
    wishes.follow(state.tracks, state.elsewhere, config)
    if is_final:
        tables = (state.tracks, state.elsewhere)
        wanted = [i for t in tables for i in next_requests(t, wishes.num_open, now_ns, is_final=True, config=config)]
    else:
        wanted = shape_requests.next_replacements(wishes.with_job(state.tracks), now_ns, config)
        wanted += wishes.next_wanted(state.tracks, now_ns, config)
    return [effect for track_id in wanted for effect in _requested(state, track_id, mapping)]


def _requested(state: MapState, track_id: int, mapping: MappingConfig) -> list[Effect]:
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
    due_ns, z_m = (state.stamp_ns or 0) + int(config.latency_s * 1e9), None if support is None else support.height_m
    request = shape_requests.shape_request(track, ticket=ticket, support_z_m=z_m, due_ns=due_ns)
    text = f"job {ticket} asked for: S {increase_in_score(track):+.3f} in {predicted_s(track, config):.1f} s, "
    text += f"new {shape_requests.gain_of(track):.2f}, {len(request.views)} views"
    state.decide("shape", track_id, text)
    asked = shape_requests.state_of_request(track, ticket, state.clock_ns, is_replacement=gone is not None)
    tracks[track_id] = replace(track, shape_state=asked)
    return [*effects, request]


def end_shape(state: MapState, event: ShapeReady | ShapeFailed) -> None:
    """Store the result of a shape job in its track, unless the job is no longer wanted."""
    tracks = state.tracks if event.object_id in state.tracks else state.elsewhere
    track = tracks.get(event.object_id)
    if track is None or track.shape_state.open_ticket != event.ticket:
        state.decide("shape", event.object_id, f"job {event.ticket} ended, but is no longer wanted")
        return
    ended = replace(track.shape_state, open_ticket=None)
    if isinstance(event, ShapeReady):
        verdict = f"; {event.shape.verdict}" if event.shape.verdict else ""
        state.decide("shape", track.id, f"job {event.ticket}: {len(event.shape.fitted)} superquadrics{verdict}")
        tracks[track.id] = replace(track, shape=event.shape, shape_state=replace(ended, failures=0))
    else:
        state.decide("shape", track.id, f"job {event.ticket} gave no shape: {event.reason}")
        tracks[track.id] = replace(track, shape_state=replace(ended, failures=ended.failures + 1))
