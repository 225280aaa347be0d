"""Which tracks were looked at lately: the clouds of all others, and of what belongs to them, are kept compressed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.geometry.made_arrays import in_memory
from hickory_stream.mapping.cold_clouds import pack, pack_part
from hickory_stream.mapping.track_table import REACH_M

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.geometry.made_arrays import Keep
    from hickory_stream.mapping.absorbed import Absorbed
    from hickory_stream.mapping.split_candidates import SplitCandidates
    from hickory_stream.mapping.track_table import Mark, TrackTable

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

    def follow(
        self,
        tracks: TrackTable,
        absorbed: Absorbed,
        candidates: SplitCandidates,
        *,
        sight: NDArray[np.float32] | None,
        revision: int,
    ) -> None:
        """Take up a keyframe that saw what is in the bounds `sight` (2, 3); `revision` is its number.

        The clouds of the tracks that no keyframe was about for some time are compressed, with those of the tracks that
        they have absorbed, and of the candidates to be split off them.
        """
        mark = self._mark if self._mark is not None and self._mark.table is tracks else None
        about = set(tracks.changed_since(mark)) & tracks.keys()
        for track_id in list(about) if mark is not None else ():
            about |= {other.id for other in tracks.touching(tracks[track_id].bounds, REACH_M)}
        if sight is not None:
            about |= {track.id for track in tracks.touching(sight, REACH_M)}
        for track_id in sorted(about):
            # At the end of the order, so that what was left longest ago comes first.
            self._last.pop(track_id, None)
            self._last[track_id] = revision
        for track_id, last in list(self._last.items()):
            if last > revision - _KEEP_KEYFRAMES:
                break
            del self._last[track_id]
            own = tracks.get(track_id)
            for track in (*absorbed.get(track_id, ()), *([own] if own is not None else [])):
                pack_part(track.solid, track.cloud, self.keep)
            for candidate in candidates.get(track_id, ()):
                pack(candidate.cloud, self.keep)
        self._mark = tracks.now
