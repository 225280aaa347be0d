"""Which tracks were looked at lately: the clouds of all others, and of what belongs to them, are kept compressed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.geometry.made_arrays import in_memory
from hickory_stream.mapping.cold_clouds import pack, pack_part
from hickory_stream.mapping.joins import tracks_in
from hickory_stream.mapping.track_table import REACH_M

if TYPE_CHECKING:
    from collections.abc import Iterable

    from hickory_stream.geometry.made_arrays import Keep
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.track_table import Mark

_KEEP_KEYFRAMES = 24
"""A robot that looks around sees a thing again within so many keyframes."""


class WarmTracks:
    """The tracks that keyframes were about lately, and those beside them, by the last keyframe.

    `keep` has what is compressed: in memory, or where the engine says.
    """

    def __init__(self) -> None:
        self.keep: Keep = in_memory
        self._mark: Mark | None = None
        self._last: dict[int, int] = {}

    def follow(self, state: MapState) -> None:
        """Take up a keyframe.

        The clouds of the tracks that no keyframe was about for some time are compressed, with those of the tracks that
        they have absorbed, or that were joined to them, and of the candidates to be split off them.
        """
        tracks, sight, revision = state.tracks, state.sight, state.revision
        mark = self._mark if self._mark is not None and self._mark.table is tracks else None
        about = set(tracks.changed_since(mark)) & tracks.keys()
        for track_id in list(about) if mark is not None else ():
            about |= {other.id for other in tracks.touching(tracks[track_id].bounds, REACH_M)}
        if sight is not None:
            about |= {track.id for track in tracks.touching(sight, REACH_M)}
        self.use(sorted(about), revision)
        for track_id, last in list(self._last.items()):
            if last > revision - _KEEP_KEYFRAMES:
                break
            del self._last[track_id]
            own = tracks.get(track_id) or state.elsewhere.get(track_id)
            joined = tracks_in(state.joins.get(track_id, ()))
            for track in (*joined, *state.absorbed.get(track_id, ()), *([own] if own is not None else [])):
                pack_part(track.solid, track.cloud, self.keep)
            for candidate in state.split_candidates.get(track_id, ()):
                pack(candidate.cloud, self.keep)
        self._mark = tracks.now

    def use(self, track_ids: Iterable[int], revision: int) -> None:
        """Note the tracks that a keyframe is about, be they here or elsewhere."""
        for track_id in track_ids:
            # At the end of the order, so that what was left longest ago comes first.
            self._last.pop(track_id, None)
            self._last[track_id] = revision
