"""The map after a step from the journal's records, each read on first use.

Records have no points and space: their first use replays the events since the last checkpoint, once for all. Replayed
objects must equal their records.
"""

from __future__ import annotations

from dataclasses import fields
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, Any

from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.lazy_arrays import read_parts
from hickory_stream.journal.record_codec import encode
from hickory_stream.journal.snapshot_records import Place, object_without_points, submap_without_space
from hickory_stream.map_folder.history.core_replay import Replay
from hickory_stream.records import MapSnapshot, ObservedSpace, PoseGraphRecord, Submap, TrackedObject

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from hickory_stream.journal.reader import Journal
    from hickory_stream.mapping.config import MappingConfig

_POINTS, _SPACE = ("points_world", "colors"), ("free", "structure")
_REST = tuple(f.name for f in fields(TrackedObject) if f.name not in ("id", *_POINTS))


def known_map(journal: Journal, index: int, config: Callable[[], MappingConfig]) -> MapSnapshot:
    """Return the map after a step; `config` is called before a replay.

    Raises `MapFolderError`: the journal is damaged; also later, on first use of a record.
    """
    known = journal.known(index)
    records = _Records(journal, index, config)
    return MapSnapshot(
        revision=known.revision,
        stamp_ns=known.stamp_ns,
        submaps=tuple(records.submap(submap_id, place) for submap_id, place in sorted(known.submaps.items())),
        objects=tuple(records.tracked(object_id, place) for object_id, place in sorted(known.objects.items())),
        graph=None if known.graph is None else journal.known_record(known.graph, PoseGraphRecord),
    )


class _Records:
    def __init__(self, journal: Journal, index: int, config: Callable[[], MappingConfig]) -> None:
        self._journal = journal
        self._index = index
        self._config = config
        self._lock = Lock()
        self._replayed: MapSnapshot | None = None

    def tracked(self, object_id: int, place: Place) -> TrackedObject:
        tracked = object.__new__(TrackedObject)
        object.__setattr__(tracked, "id", object_id)
        read_parts(tracked, partial(self._of_object, object_id, place), *_REST, *_POINTS)
        return tracked

    def submap(self, submap_id: int, place: Place) -> Submap:
        submap = self._read_submap(submap_id, place)
        read_parts(submap.observed_space, partial(self._of_space, submap_id, place), *_SPACE)
        return submap

    def _of_object(self, object_id: int, place: Place, name: str) -> Mapping[str, Any]:
        read: TrackedObject = self._journal.known_record(place, TrackedObject)
        self._check(read.id == object_id, "object", object_id)
        if name not in _POINTS:
            return {each: getattr(read, each) for each in _REST}
        found = next((one for one in self._replay().objects if one.id == object_id), None)
        is_same = found is not None and encode(object_without_points(found)) == encode(read)
        self._check(is_same, "object", object_id)
        return {each: getattr(found, each) for each in _POINTS}

    def _read_submap(self, submap_id: int, place: Place) -> Submap:
        submap: Submap = self._journal.known_record(place, Submap)
        self._check(submap.id == submap_id, "submap", submap_id)
        return submap

    def _of_space(self, submap_id: int, place: Place, _: str) -> Mapping[str, Any]:
        found = next((one for one in self._replay().submaps if one.id == submap_id), None)
        read = self._read_submap(submap_id, place)
        is_same = found is not None and encode(submap_without_space(found)) == encode(read)
        self._check(is_same, "submap", submap_id)
        assert found is not None
        space: ObservedSpace = found.observed_space
        return {each: getattr(space, each) for each in _SPACE}

    def _replay(self) -> MapSnapshot:
        with self._lock:
            if self._replayed is None:
                replay = Replay(self._journal, self._config(), reads_later=True)
                replay.seek(self._index)
                self._replayed = replay.snapshot()
            return self._replayed

    def _check(self, is_same: bool, kind: str, number: int) -> None:
        if not is_same:
            raise MapFolderError(
                f"{self._journal.path} is damaged or of another version: "
                f"its record of {kind} {number} is not what its events make; play the log again"
            )
