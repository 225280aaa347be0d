"""The voxels of tracks that are part of the room, by track, so that the observed space follows those that change."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.voxels import difference, keys_of_points, sorted_unique
from hickory_stream.mapping.submaps import with_room, with_room_changed
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hickory_stream.mapping.cloud import Cloud
    from hickory_stream.mapping.submaps import Submaps
    from hickory_stream.mapping.track import Track
    from hickory_stream.mapping.track_table import Mark, TrackTable

_NONE = np.empty(0, dtype=np.int64)


class RoomVoxels:
    """The clouds of the tracks that are part of the room and were seen since the last jump, as the submaps have them.

    `first` is the first submap that is judged; the space of another one has other tracks.
    """

    def __init__(self, first: int = 0) -> None:
        self._first = first
        self._clouds: dict[int, Cloud] = {}
        self._mark: Mark | None = None

    @classmethod
    def of_tracks(cls, tracks: TrackTable, first: int) -> RoomVoxels:
        """Return the voxels of a state whose submaps have them."""
        room = cls(first)
        room._clouds = {track.id: track.solid for track in tracks.values() if _is_room(track, first)}
        room._mark = tracks.now
        return room

    def kept(self, submaps: Submaps, tracks: TrackTable) -> Submaps:
        """Return the submaps with the voxels of the tracks as they are now."""
        mark, self._mark = self._mark, tracks.now
        if submaps.first != self._first or (mark is not None and mark.table is not tracks):
            return self._renewed(submaps, tracks)
        changed: list[tuple[Cloud | None, Cloud | None]] = []
        for track_id in tracks.changed_since(mark):
            track = tracks.get(track_id)
            before = self._clouds.get(track_id)
            now = track.solid if track is not None and _is_room(track, submaps.first) else None
            if now is before:
                continue
            changed.append((before, now))
            if now is None:
                del self._clouds[track_id]
            else:
                self._clouds[track_id] = now
        return self._changed(submaps, tracks, changed) if changed else submaps

    def _renewed(self, submaps: Submaps, tracks: TrackTable) -> Submaps:
        self._first = submaps.first
        aside = [track for track in tracks.ordered() if _is_room(track, submaps.first)]
        self._clouds = {track.id: track.solid for track in aside}
        return with_room(submaps, _voxels(self._clouds.values(), submaps.space.voxel_m))

    def _changed(
        self, submaps: Submaps, tracks: TrackTable, changed: list[tuple[Cloud | None, Cloud | None]]
    ) -> Submaps:
        voxel_m = submaps.space.voxel_m
        new = _voxels((now for _, now in changed if now is not None), voxel_m)
        gone = difference(_voxels((before for before, _ in changed if before is not None), voxel_m), new)
        if len(gone):
            points = np.concatenate([before.points for before, _ in changed if before is not None])
            beside = tracks.touching(np.stack([points.min(axis=0), points.max(axis=0)]), 2 * voxel_m)
            others = (self._clouds[track.id] for track in beside if track.id in self._clouds)
            gone = difference(gone, _voxels(others, voxel_m))
        return with_room_changed(submaps, gone, new)


def _is_room(track: Track, first: int) -> bool:
    return track.phase is Phase.ROOM and track.seen_in >= first


def _voxels(clouds: Iterable[Cloud], voxel_m: float) -> NDArray[np.int64]:
    return sorted_unique(np.concatenate([_NONE, *(keys_of_points(cloud.points, voxel_m) for cloud in clouds)]))
