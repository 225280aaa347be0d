"""Which tracks have an open shape job, and which may want one, followed from the tracks that have changed."""

from __future__ import annotations

from bisect import bisect_left, insort
from itertools import islice
from typing import TYPE_CHECKING

from hickory_stream.mapping.requests import is_wanted, may_be_wanted, rank_of

if TYPE_CHECKING:
    from hickory_stream.mapping.requests import Rank, RequestConfig
    from hickory_stream.mapping.track import Track
    from hickory_stream.mapping.track_table import Mark, TrackTable


class ShapeWishes:
    """The ids of tracks with an open job, here and elsewhere, and of those here whose shape may be wanted by now."""

    def __init__(self) -> None:
        self._here = _Followed()
        self._elsewhere = _Followed()

    def follow(self, tracks: TrackTable, elsewhere: TrackTable, config: RequestConfig) -> None:
        """Take up what has changed in the tables."""
        self._here.follow(tracks, config)
        self._elsewhere.follow(elsewhere, config)

    @property
    def num_open(self) -> int:
        """How many jobs are open."""
        return len(self._here.with_job) + len(self._elsewhere.with_job)

    def with_job(self, tracks: TrackTable) -> dict[int, Track]:
        """Return the tracks here that have an open job."""
        return {i: tracks[i] for i in sorted(self._here.with_job)}

    def next_wanted(self, tracks: TrackTable, clock_ns: int, config: RequestConfig) -> list[int]:
        """Return what `next_requests` does of the tracks here; what waits for a free job is not looked at."""
        ranked = (rank[-1] for rank in self._here.wanting)
        wanted = (i for i in ranked if is_wanted(tracks[i], clock_ns, is_final=False, config=config))
        return list(islice(wanted, max(0, config.max_in_flight - self.num_open)))


class _Followed:
    """The ids of one table; those whose shape may be wanted with their ranks, in the order of these."""

    def __init__(self) -> None:
        self._mark: Mark | None = None
        self.with_job: set[int] = set()
        self.wanting: list[Rank] = []
        self._ranks: dict[int, Rank] = {}

    def follow(self, table: TrackTable, config: RequestConfig) -> None:
        if self._mark is not None and self._mark.table is not table:
            self._mark = None
        if self._mark is None:
            self.with_job, self.wanting, self._ranks = set(), [], {}
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
