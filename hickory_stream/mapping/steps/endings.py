"""Ends of tracks, by drop or merge; and compression of tracks that were not seen recently."""

from collections.abc import Iterable

from hickory_stream.events import CancelShape, Effect
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.cloud import pack, pack_part
from hickory_stream.mapping.entities.submaps import compress_unused
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules.merge_history import after_merge, after_union, tracks_in
from hickory_stream.mapping.rules.merging import merge
from hickory_stream.mapping.rules.splitting import reassigned
from hickory_stream.records import DropCause


def drop(state: MapState, track: Track, cause: DropCause, reason: str | None = None) -> list[Effect]:
    """Drop a track that turned out not to be an object."""
    (state.tracks if track.id in state.tracks else state.elsewhere).pop(track.id)
    state.votes = state.votes.without(track.id)
    state.split_candidates.pop(track.id, None)
    state.absorbed.pop(track.id, None)
    state.joins.pop(track.id, None)
    state.decide("drop", track.id, f"{reason or cause}, after {track.sightings} sightings", cause=cause)
    return cancelled(track)


def unite(state: MapState, kept_id: int, gone_id: int, reason: str, config: MappingConfig) -> list[Effect]:
    """Merge a track into another one of the same frame, with its points, views, votes and candidates."""
    tracks = state.tracks if kept_id in state.tracks else state.elsewhere
    kept, gone = tracks[kept_id], tracks.pop(gone_id)
    tracks[kept_id] = merge(kept, gone, config.voxels.object_m)
    state.votes = state.votes.merged(kept_id, gone_id)
    state.split_candidates = reassigned(state.split_candidates, kept_id, gone_id)
    state.absorbed = after_merge(state.absorbed, kept_id, gone)
    state.joins = after_union(state.joins, kept_id, gone_id)
    state.decide("merge", kept_id, f"#{gone_id} is the same: {reason}", other_id=gone_id)
    return cancelled(gone)


def cancelled(gone: Track) -> list[Effect]:
    """Return the effect that cancels the open shape job of a track, if it has one."""
    ticket = gone.shape_state.open_ticket
    return [] if ticket is None else [CancelShape(ticket=ticket)]


def compress_tracks(state: MapState, track_ids: Iterable[int]) -> None:
    """Compress the clouds of tracks, of the tracks merged into them, and of their split candidates."""
    keep = state.derived.warm.keep
    for track_id in track_ids:
        own = state.tracks.get(track_id) or state.elsewhere.get(track_id)
        joined = tracks_in(state.joins.get(track_id, ()))
        for track in (*joined, *state.absorbed.get(track_id, ()), *([own] if own is not None else [])):
            pack_part(track.solid, track.cloud, keep)
        for candidate in state.split_candidates.get(track_id, ()):
            pack(candidate.cloud, keep)


def compress_elsewhere(state: MapState) -> None:
    """Compress tracks elsewhere, joins, and spaces that are not judged, after a correction of the poses."""
    compress_tracks(state, sorted({*state.elsewhere, *state.joins}))
    compress_unused(state.submaps, state.derived.warm.keep)
