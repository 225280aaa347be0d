"""Values derived from the tracks of a state, updated as tracks change; they are not saved."""

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import islice, takewhile
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.lazy_arrays import Keep, in_memory
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.entities.track_table import REACH_M, Mark, TrackTable
from hickory_stream.mapping.rules.merge_history import Absorbed, Join, Joins, views_in
from hickory_stream.mapping.rules.shape_requests import Rank, RequestConfig, is_wanted, may_be_wanted, rank_of


class ViewUse:
    """The number of tracks that hold each view, with the tracks that a split or an unmerge could restore."""

    def __init__(self) -> None:
        self._marks: tuple[Mark, Mark] | None = None
        self._held: dict[int, tuple[str, ...]] = {}
        self._absorbed: dict[int, tuple[Track, ...]] = {}
        self._joins: dict[int, tuple[Join, ...]] = {}
        self._num_holders: Counter[str] = Counter()
        self._freed: set[str] = set()

    def ask_for(self, name: str) -> None:
        """Check at the next count whether a view is held: a better one may have replaced it by then."""
        self._freed.add(name)

    def unused(
        self, tracks: TrackTable, elsewhere: TrackTable, absorbed: Absorbed, joins: Joins, kept: Collection[str]
    ) -> list[str]:
        """Return the names of the `kept` views that nothing refers to any more, ascending."""
        tables = (tracks, elsewhere)
        marks = self._marks
        if marks is None or any(mark.table is not table for mark, table in zip(marks, tables, strict=True)):
            marks = None
            self._held, self._absorbed, self._joins, self._num_holders = {}, {}, {}, Counter()
            self._freed = set(kept)
        for table, mark in zip(tables, marks or (None, None), strict=True):
            for track_id in table.changed_since(mark):
                # A track that is in neither table is gone; one may have come from the other.
                track = tracks.get(track_id) or elsewhere.get(track_id)
                before, names = self._held.pop(track_id, ()), () if track is None else track.names_of_views
                if names:
                    self._held[track_id] = names
                self._count(before, names)
        self._marks = (tracks.now, elsewhere.now)
        self._follow(self._absorbed, absorbed, lambda own: [name for track in own for name in track.names_of_views])
        self._follow(self._joins, joins, views_in)
        self._absorbed, self._joins = dict(absorbed), dict(joins)
        unused = sorted(name for name in self._freed if not self._num_holders[name] and name in kept)
        self._freed = set()
        return unused

    def _follow(self, known: Mapping[int, Any], now: Mapping[int, Any], names: Callable[[Any], Iterable[str]]) -> None:
        changed = [host for host, held in now.items() if known.get(host) is not held]
        changed += [host for host in known if host not in now]
        for host in changed:
            self._count(names(known.get(host, ())), names(now.get(host, ())))

    def _count(self, before: Iterable[str], now: Iterable[str]) -> None:
        self._num_holders.update(now)
        for name in before:
            self._num_holders[name] -= 1
            if not self._num_holders[name]:
                del self._num_holders[name]
                self._freed.add(name)


# A robot that looks around sees a thing again within so many keyframes.
_KEEP_KEYFRAMES = 24


class RecentTracks:
    """The tracks seen or changed recently, and their neighbours, by the last keyframe.

    `keep` holds the compressed arrays of all others: in memory, or where the engine says.
    """

    def __init__(self) -> None:
        self.keep: Keep = in_memory
        self._mark: Mark | None = None
        self._last: dict[int, int] = {}

    def follow(self, tracks: TrackTable, *, sight: NDArray[np.float32] | None, revision: int) -> list[int]:
        """Update with keyframe `revision`, which saw the bounds `sight` (2, 3); return the tracks to compress."""
        mark = self._mark if self._mark is not None and self._mark.table is tracks else None
        about = set(tracks.changed_since(mark)) & tracks.keys()
        for track_id in list(about) if mark is not None else ():
            about |= {other.id for other in tracks.touching(tracks[track_id].bounds, REACH_M)}
        if sight is not None:
            about |= {track.id for track in tracks.touching(sight, REACH_M)}
        self.use(sorted(about), revision)
        resting = [i for i, _ in takewhile(lambda item: item[1] <= revision - _KEEP_KEYFRAMES, self._last.items())]
        for track_id in resting:
            del self._last[track_id]
        self._mark = tracks.now
        return resting

    def use(self, track_ids: Iterable[int], revision: int) -> None:
        """Mark tracks as used by a keyframe."""
        for track_id in track_ids:
            # At the end of the order: the track left longest ago comes first.
            self._last.pop(track_id, None)
            self._last[track_id] = revision


class ShapeWishes:
    """The ids of tracks with an open shape job, and of tracks here whose shape may be wanted by now."""

    def __init__(self) -> None:
        self._here = _Followed()
        self._elsewhere = _Followed()

    def follow(self, tracks: TrackTable, elsewhere: TrackTable, config: RequestConfig) -> None:
        """Update with the changes of the tables."""
        self._here.follow(tracks, config)
        self._elsewhere.follow(elsewhere, config)

    @property
    def num_open(self) -> int:
        """The number of open jobs."""
        return len(self._here.with_job) + len(self._elsewhere.with_job)

    def with_job(self, tracks: TrackTable) -> dict[int, Track]:
        """Return the tracks here that have an open job."""
        return {i: tracks[i] for i in sorted(self._here.with_job)}

    def next_wanted(self, tracks: TrackTable, clock_ns: int, config: RequestConfig) -> list[int]:
        """Return the result of `next_requests` for the tracks here; tracks without a free job are not tested."""
        ranked = (rank[-1] for rank in self._here.wanting)
        wanted = (i for i in ranked if is_wanted(tracks[i], clock_ns, is_final=False, config=config))
        return list(islice(wanted, max(0, config.max_in_flight - self.num_open)))


class _Followed:
    def __init__(self) -> None:
        self._mark: Mark | None = None
        self.with_job: set[int] = set()
        self.wanting: list[Rank] = []
        self._ranks: dict[int, Rank] = {}

    def follow(self, table: TrackTable, config: RequestConfig) -> None:
        if self._mark is None or self._mark.table is not table:
            self._mark, self.with_job, self.wanting, self._ranks = None, set(), [], {}
        for track_id in table.changed_since(self._mark):
            track = table.get(track_id)
            has_job = track is not None and track.shape_state.open_ticket is not None
            (self.with_job.add if has_job else self.with_job.discard)(track_id)
            if (rank := self._ranks.pop(track_id, None)) is not None:
                del self.wanting[bisect_left(self.wanting, rank)]
            if track is not None and may_be_wanted(track, config):
                self._ranks[track_id] = rank_of(track, config)
                insort(self.wanting, self._ranks[track_id])
        self._mark = table.now


@dataclass(slots=True, eq=False)
class PlacedTrack:
    """A track elsewhere in the frame of the open submap: its centre (3,) and radius, and itself while it is in view."""

    track: Track
    #: the poses (4, 4) of its submap and of the open one
    places: tuple[NDArray[np.float64], NDArray[np.float64]]
    center: NDArray[np.float64]
    radius_m: float
    moved: Track | None = None


@dataclass(kw_only=True, slots=True, eq=False)
class Derived:
    """Everything that is derived from a state."""

    views: ViewUse = field(default_factory=ViewUse)
    wishes: ShapeWishes = field(default_factory=ShapeWishes)
    warm: RecentTracks = field(default_factory=RecentTracks)
    #: by id, of the last keyframe
    placed: dict[int, PlacedTrack] = field(default_factory=dict)
