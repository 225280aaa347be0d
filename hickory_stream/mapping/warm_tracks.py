"""Which tracks were looked at lately: the clouds of all others, and of what belongs to them, are kept compressed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.geometry.made_arrays import in_memory
from hickory_stream.mapping.track_table import REACH_M

if TYPE_CHECKING:
    from collections.abc import Iterable

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.geometry.made_arrays import Keep
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

    def follow(self, tracks: TrackTable, *, sight: NDArray[np.float32] | None, revision: int) -> list[int]:
        """Take up a keyframe that saw what is in the bounds `sight` (2, 3); `revision` is its number.

        Returns the ids of the tracks that no keyframe was about for some time.
        """
        mark = self._mark if self._mark is not None and self._mark.table is tracks else None
        about = set(tracks.changed_since(mark)) & tracks.keys()
        for track_id in list(about) if mark is not None else ():
            about |= {other.id for other in tracks.touching(tracks[track_id].bounds, REACH_M)}
        if sight is not None:
            about |= {track.id for track in tracks.touching(sight, REACH_M)}
        self.use(sorted(about), revision)
        resting = []
        for track_id, last in self._last.items():
            if last > revision - _KEEP_KEYFRAMES:
                break
            resting.append(track_id)
        for track_id in resting:
            del self._last[track_id]
        self._mark = tracks.now
        return resting

    def use(self, track_ids: Iterable[int], revision: int) -> None:
        """Note the tracks that a keyframe is about, be they here or elsewhere."""
        for track_id in track_ids:
            # At the end of the order, so that what was left longest ago comes first.
            self._last.pop(track_id, None)
            self._last[track_id] = revision
