"""What a correction has looked at is compressed again where nobody needs it now: what lies elsewhere, and joins."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.mapping.cold_clouds import pack_part
from hickory_stream.mapping.joins import tracks_in
from hickory_stream.mapping.submaps import put_far_away

if TYPE_CHECKING:
    from collections.abc import Iterator

    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.track import Track


def put_away(state: MapState) -> None:
    """Compress the clouds of tracks elsewhere and of joins, and the spaces of submaps that are not judged."""
    keep = state.derived.warm.keep
    for track in _resting(state):
        pack_part(track.solid, track.cloud, keep)
    put_far_away(state.submaps, keep)


def _resting(state: MapState) -> Iterator[Track]:
    yield from state.elsewhere.values()
    for host_id in state.elsewhere.keys() & state.absorbed.keys():
        yield from state.absorbed[host_id]
    for joins in state.joins.values():
        yield from tracks_in(joins)
