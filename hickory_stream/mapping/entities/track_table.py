"""A table of tracks that knows where each one lies, when it was seen, and which ones have changed.

A keyframe must cost by what it sees, not by the number of tracks: a grid finds tracks around a place, sighting times
are sorted, and derived values ask only for changes.
"""

from bisect import bisect_left, bisect_right, insort
from collections.abc import Iterable, Iterator, Mapping, MutableMapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.mapping.entities.track import Track, touching

# The side of a cell of the grid: about a large object, so that most tracks lie in one to four.
_CELL_M = 2.0

# Further than any check of a track looks around it.
REACH_M = 0.5

# Bounds and slacks are compared in single precision, cells are found in double precision.
_ROUNDING_M = 0.01

_Box = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True)
class Mark:
    """A moment of a table, for asking what changed after it."""

    table: "TrackTable"
    serial: int


class TrackTable(MutableMapping[int, "Track"]):
    """Tracks by id. All changes go through item assignment, deletion and `pop`."""

    def __init__(self, tracks: Mapping[int, Track] | Iterable[tuple[int, Track]] = ()) -> None:
        self._tracks: dict[int, Track] = {}
        self._boxes: dict[int, _Box] = {}
        self._cells: dict[tuple[int, int], set[int]] = {}
        self._seen: list[tuple[int, int]] = []
        self._host_of: dict[int, int] = {}
        self._serial = 0
        self._changed: dict[int, int] = {}
        self.update(tracks)

    def __getitem__(self, track_id: int) -> Track:
        return self._tracks[track_id]

    def __iter__(self) -> Iterator[int]:
        return iter(self._tracks)

    def __len__(self) -> int:
        return len(self._tracks)

    def __contains__(self, track_id: object) -> bool:
        return track_id in self._tracks

    def __setitem__(self, track_id: int, track: Track) -> None:
        old = self._tracks.get(track_id)
        if old is track:
            return
        self._tracks[track_id] = track
        self._note(track_id)
        if old is None or old.bounds is not track.bounds:
            self._move(track_id, _box_of(track.bounds))
        if old is None or old.seen_clock_ns != track.seen_clock_ns:
            if old is not None:
                self._forget_seen(old)
            insort(self._seen, (track.seen_clock_ns, track_id))
        if old is None or old.merged_ids is not track.merged_ids:
            self._host_of.update(dict.fromkeys(track.merged_ids, track_id))

    def __delitem__(self, track_id: int) -> None:
        track = self._tracks.pop(track_id)
        self._note(track_id)
        self._move(track_id, None)
        self._forget_seen(track)
        for gone in track.merged_ids:
            if self._host_of.get(gone) == track_id:
                del self._host_of[gone]

    def ordered(self) -> list[Track]:
        """Return all tracks in the order of their ids."""
        return [self._tracks[i] for i in sorted(self._tracks)]

    def touching(self, bounds: NDArray[np.float32], slack_m: float = 0.03) -> list[Track]:
        """Return the tracks whose bounds come within `slack_m` of the given ones (2, 3), in the order of their ids."""
        near: set[int] = set()
        for cell in _cells_of(_box_of(bounds, slack_m + _ROUNDING_M)) if len(self._cells) else ():
            near |= self._cells.get(cell, _NONE)
        return touching(bounds, [self._tracks[i] for i in sorted(near)], slack_m)

    def last_seen(self, after_ns: int, until_ns: int) -> list[int]:
        """Return the ids of the tracks that were last seen after one time of the core's clock, until another."""
        first = bisect_right(self._seen, (after_ns, 1 << 62))
        last = bisect_right(self._seen, (until_ns, 1 << 62))
        return [track_id for _, track_id in self._seen[first:last]]

    def host_of(self, track_id: int) -> int | None:
        """Return the id of the track here into which a track was merged; None if there is none."""
        return self._host_of.get(track_id)

    @property
    def now(self) -> Mark:
        """The present moment."""
        return Mark(self, self._serial)

    def changed_since(self, mark: Mark | None) -> list[int]:
        """Return the ids of tracks that were made, changed or removed since a moment, ascending; None: all tracks."""
        if mark is None or mark.table is not self:
            return sorted(self._tracks)
        changed = []
        for track_id, serial in reversed(self._changed.items()):
            if serial <= mark.serial:
                break
            changed.append(track_id)
        return sorted(changed)

    def _note(self, track_id: int) -> None:
        self._serial += 1
        # At the end of the order, so that what has changed last is found first.
        self._changed.pop(track_id, None)
        self._changed[track_id] = self._serial

    def _move(self, track_id: int, box: _Box | None) -> None:
        before = self._boxes.get(track_id)
        if before == box:
            return
        for cell in _cells_of(before) if before is not None else ():
            inside = self._cells[cell]
            inside.discard(track_id)
            if not inside:
                del self._cells[cell]
        if box is None:
            self._boxes.pop(track_id, None)
            return
        self._boxes[track_id] = box
        for cell in _cells_of(box):
            self._cells.setdefault(cell, set()).add(track_id)

    def _forget_seen(self, track: Track) -> None:
        del self._seen[bisect_left(self._seen, (track.seen_clock_ns, track.id))]


_NONE: frozenset[int] = frozenset()


def _box_of(bounds: NDArray[np.float32], slack_m: float = 0.0) -> _Box:
    # The least and the greatest cell of bounds (2, 3), along x and y.
    low, high = bounds[0], bounds[1]
    return (
        int((float(low[0]) - slack_m) // _CELL_M),
        int((float(low[1]) - slack_m) // _CELL_M),
        int((float(high[0]) + slack_m) // _CELL_M),
        int((float(high[1]) + slack_m) // _CELL_M),
    )


def _cells_of(box: _Box) -> Iterator[tuple[int, int]]:
    low_x, low_y, high_x, high_y = box
    return ((x, y) for x in range(low_x, high_x + 1) for y in range(low_y, high_y + 1))
