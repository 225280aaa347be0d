"""Which tracks have an open shape job, and which may want one, followed from the tracks that have changed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.mapping.requests import may_be_wanted

if TYPE_CHECKING:
    from hickory_stream.mapping.requests import RequestConfig
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

    def wanting(self, tracks: TrackTable) -> dict[int, Track]:
        """Return the tracks here whose shape may be wanted."""
        return {i: tracks[i] for i in sorted(self._here.wanting)}


class _Followed:
    """The ids of one table."""

    def __init__(self) -> None:
        self._mark: Mark | None = None
        self.with_job: set[int] = set()
        self.wanting: set[int] = set()

    def follow(self, table: TrackTable, config: RequestConfig) -> None:
        if self._mark is not None and self._mark.table is not table:
            self._mark = None
        if self._mark is None:
            self.with_job, self.wanting = set(), set()
        for track_id in table.changed_since(self._mark):
            track = table.get(track_id)
            _put(self.with_job, track_id, track is not None and track.shape_state.open_ticket is not None)
            _put(self.wanting, track_id, track is not None and may_be_wanted(track, config))
        self._mark = table.now


def _put(ids: set[int], track_id: int, is_in: bool) -> None:
    (ids.add if is_in else ids.discard)(track_id)
