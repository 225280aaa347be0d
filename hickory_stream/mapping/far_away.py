"""What nobody looks at any more is compressed: tracks that rest, and what a correction of poses has looked at."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.mapping.cold_clouds import pack, pack_part
from hickory_stream.mapping.joins import tracks_in
from hickory_stream.mapping.submaps import put_far_away

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hickory_stream.mapping.map_state import MapState


def rest_tracks(state: MapState, track_ids: Iterable[int]) -> None:
    """Compress the clouds of tracks, here or elsewhere.

    With them those of the tracks that they have absorbed, or that were joined to them, and of the candidates to be
    split off them.
    """
    keep = state.derived.warm.keep
    for track_id in track_ids:
        own = state.tracks.get(track_id) or state.elsewhere.get(track_id)
        joined = tracks_in(state.joins.get(track_id, ()))
        for track in (*joined, *state.absorbed.get(track_id, ()), *([own] if own is not None else [])):
            pack_part(track.solid, track.cloud, keep)
        for candidate in state.split_candidates.get(track_id, ()):
            pack(candidate.cloud, keep)


def rest_elsewhere(state: MapState) -> None:
    """Compress what a correction of poses has looked at: tracks elsewhere, joins, spaces that are not judged."""
    rest_tracks(state, sorted({*state.elsewhere, *state.joins}))
    put_far_away(state.submaps, state.derived.warm.keep)
