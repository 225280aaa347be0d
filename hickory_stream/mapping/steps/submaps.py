"""Submaps in the steps of a keyframe: begin and view, jumps of the odometry, ends, and searches for loops."""

from collections.abc import Callable

from hickory_stream.events import FrameObserved, LoopsSearched, PoseJumped, SearchLoops
from hickory_stream.geometry import portable
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities import submaps
from hickory_stream.mapping.entities.observed_space import floor_change
from hickory_stream.mapping.entities.submaps import SubmapConfig, looking_at
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules.space_agreement import agreed_after
from hickory_stream.mapping.steps.endings import compress_tracks
from hickory_stream.records import MapSnapshot


def begin_keyframe(state: MapState, event: FrameObserved, config: MappingConfig) -> None:
    """Advance the clock, the revision and the submaps; raises `ValueError` while features are pending."""
    if state.pending is not None:
        raise ValueError(f"frame {event.frame_index} came before the features of frame {state.pending.frame_index}")
    state.revision += 1
    state.advance_clock(event.stamp_ns)
    warm = state.derived.warm
    moved = submaps.with_keyframe(state.submaps, event, config.submaps)
    state.submaps = looking_at(moved, event.space, warm.keep)
    compress_tracks(state, warm.follow(state.tracks, sight=state.sight, revision=state.revision))
    for rejected in event.rejected:
        state.decide("reject", None, f"mask {rejected.box_px}: {rejected.reason}")


def see_space(state: MapState, event: FrameObserved) -> None:
    """Add the keyframe's free space, structure and floor."""
    seen_m = event.space.floor_z_m
    changed = floor_change(state.submaps.space, seen_m, submaps.false_floor(state.submaps, seen_m))
    if changed is not None:
        state.decide("floor", None, changed)
    state.submaps = submaps.with_seen(state.submaps, event.space, state.derived.warm.keep)


def jump(state: MapState, event: PoseJumped) -> None:
    """Close the submap: the odometry has jumped."""
    # Later poses are in the same world frame, so objects can be re-identified. The observed space starts empty: an
    # error of a few centimetres in the jump would see through an object, or place it inside a wall.
    gap_s = (event.stamp_ns - (state.stamp_ns or event.stamp_ns)) / 1e9
    state.submaps = submaps.after_pose_jump(state.submaps, event.after_from_before, max(gap_s, 0.0))
    state.split_candidates = {}
    now_id, distance_m = state.submaps.open_id, portable.norm(event.after_from_before[:3, 3])
    state.decide("pose_jump", None, f"the odometry jumped by {distance_m:.2f} m: submap {now_id} begins")


def end_submap(
    state: MapState, open_id: int | None, snapshot: Callable[[], MapSnapshot], config: SubmapConfig
) -> list[SearchLoops]:
    """Return the search for loops of the submap `open_id` if it has ended; None: the open one ends now."""
    if open_id == state.submaps.open_id:
        return []
    submap_id = state.submaps.open_id if open_id is None else open_id
    state.submaps = agreed_after(state.submaps, submap_id)
    submaps.compress_unused(state.submaps, state.derived.warm.keep)
    states = state.submaps.states[: submap_id + 1]
    if not config.searches_loops or submap_id == 0 or len(states[-1].surface) == 0:
        return []
    search = SearchLoops(
        submap_id=submap_id,
        due_ns=(state.stamp_ns or 0) + int(config.loop_latency_s * 1e9),
        submaps=tuple(submaps.surveyed(submap) for submap in states),
        loops=state.loops,
        snapshot=snapshot(),
    )
    state.searches = (*state.searches, search)
    return [search]


def end_search(state: MapState, event: LoopsSearched) -> None:
    """Keep the loops of a search; raises `ValueError` if it was not asked for."""
    if event.submap_id not in {search.submap_id for search in state.searches}:
        raise ValueError(f"loops of submap {event.submap_id} were not asked for")
    state.searches = tuple(search for search in state.searches if search.submap_id != event.submap_id)
    state.loops = (*state.loops, *event.loops)
    for loop in event.loops:
        way = {"surface": "their surfaces", "appearance": "their images", "objects": "their objects"}[loop.method]
        said = "may be a loop" if loop.reason is None else f"is no loop: {loop.reason}"
        text = f"submap {loop.later} in {loop.earlier}, by {way}, {loop.score:.0%} of the surface agrees: {said}"
        state.decide("loop", None, text)
