"""Ends of submaps, and searches for loops: asked for then, answered later; the answers are kept, believed or not."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.events import SearchLoops
from hickory_stream.mapping.space_agreement import agreed_after
from hickory_stream.mapping.submaps import put_far_away, surveyed

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.events import LoopsSearched
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.submaps import SubmapConfig
    from hickory_stream.records import MapSnapshot


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
