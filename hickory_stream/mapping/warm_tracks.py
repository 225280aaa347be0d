"""Which tracks were looked at lately: the clouds of all others are kept compressed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.mapping.cold_clouds import pack_part
from hickory_stream.mapping.track_table import REACH_M

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.mapping.track_table import Mark, TrackTable

_KEEP_KEYFRAMES = 24
"""A robot that looks around sees a thing again within so many keyframes."""


class WarmTracks:
    """The tracks that keyframes were about lately, and those beside them, by the last keyframe."""

    def __init__(self) -> None:
        self._mark: Mark | None = None
        self._last: dict[int, int] = {}

    def follow(self, tracks: TrackTable, sight: NDArray[np.float32] | None, revision: int) -> None:
        """Take up a keyframe that saw what is in the bounds `sight` (2, 3); `revision` is its number.

        The clouds of the tracks that no keyframe was about for some time are compressed.
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
            if (track := tracks.get(track_id)) is not None:
                pack_part(track.solid, track.cloud)
        self._mark = tracks.now
