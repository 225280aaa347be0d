"""Public records of the map after each step, without points and space: reading an earlier map needs no replay.

A changed record is written, others are referred to; views and shapes, which outlive changes, are separate parts.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from hickory_stream.journal.record_codec import encode
from hickory_stream.records import MapSnapshot, ObjectShape, PoseGraphRecord, Submap, TrackedObject, View

Place = tuple[int, int]
"""A chunk of the journal, and the number of a message in it."""

_WHOLE_EVERY = 16
"""Steps that are read at most to find all records."""
_NO_POINTS, _NO_COLORS = np.empty((0, 3), np.float32), np.empty((0, 3), np.uint8)
_NO_KEYS = np.empty(0, np.int64)
_Record = TypeVar("_Record", TrackedObject, Submap)


@dataclass(frozen=True, kw_only=True, slots=True)
class Known:
    """Places of the map's records after a step, by id.

    If `is_whole`, all are listed, else the changed ones; others keep their places unless they are gone. `revision` and
    `stamp_ns` are the map's.
    """

    revision: int
    stamp_ns: int
    is_whole: bool
    objects: Mapping[int, tuple[int, int]]
    submaps: Mapping[int, tuple[int, int]]
    graph: tuple[int, int] | None
    gone_objects: tuple[int, ...] = ()
    gone_submaps: tuple[int, ...] = ()


def object_without_points(tracked: TrackedObject) -> TrackedObject:
    """Return an object without points."""
    return replace(tracked, points_world=_NO_POINTS, colors=_NO_COLORS)


def submap_without_space(submap: Submap) -> Submap:
    """Return a submap without observed space."""
    return replace(submap, observed_space=replace(submap.observed_space, free=_NO_KEYS, structure=_NO_KEYS))


class SnapshotRecords:
    """Makes the messages of consecutive maps; unchanged records are found by identity."""

    def __init__(self) -> None:
        self._objects: dict[int, _Written] = {}
        self._submaps: dict[int, _Written] = {}
        self._graph: _Written | None = None
        self._num_maps = 0

    def messages(self, snapshot: MapSnapshot, chunk: int) -> list[bytes]:
        """Return the messages of a chunk for a map: the places, then the new records."""
        new: list[bytes] = []
        objects_before, submaps_before = self._objects, self._submaps
        self._objects = _written(objects_before, snapshot.objects, object_without_points, chunk, new)
        self._submaps = _written(submaps_before, snapshot.submaps, submap_without_space, chunk, new)
        if snapshot.graph is None:
            self._graph = None
        elif self._graph is None or self._graph.record is not snapshot.graph:
            new.append(encode(snapshot.graph))
            self._graph = _Written(snapshot.graph, (chunk, len(new)))
        is_whole = self._num_maps % _WHOLE_EVERY == 0
        self._num_maps += 1
        known = Known(
            revision=snapshot.revision,
            stamp_ns=snapshot.stamp_ns,
            is_whole=is_whole,
            objects=_places(self._objects, {} if is_whole else objects_before),
            submaps=_places(self._submaps, {} if is_whole else submaps_before),
            graph=None if self._graph is None else self._graph.place,
            gone_objects=() if is_whole else tuple(sorted(objects_before.keys() - self._objects.keys())),
            gone_submaps=() if is_whole else tuple(sorted(submaps_before.keys() - self._submaps.keys())),
        )
        return [encode(known), *new]


@dataclass(frozen=True, slots=True, eq=False)
class _Written:
    record: TrackedObject | Submap | PoseGraphRecord
    place: Place
    parts: Mapping[int, tuple[object, Place]] = field(default_factory=dict)


class _Parts:
    # As `record_codec.PartStore`; parts of the record before are not written again.
    def __init__(self, before: Mapping[int, tuple[object, Place]], chunk: int, new: list[bytes]) -> None:
        self.used: dict[int, tuple[object, Place]] = {}
        self._before = before
        self._chunk = chunk
        self._new = new

    def is_part(self, record: object) -> bool:
        return isinstance(record, View | ObjectShape)

    def put(self, part: object, encoded: Callable[[], bytes]) -> Place:
        known = self.used.get(id(part)) or self._before.get(id(part))
        if known is None or known[0] is not part:
            self._new.append(encoded())
            known = (part, (self._chunk, len(self._new)))
        self.used[id(part)] = known
        return known[1]


def _written(
    before: Mapping[int, _Written],
    records: Iterable[_Record],
    without_arrays: Callable[[_Record], _Record],
    chunk: int,
    new: list[bytes],
) -> dict[int, _Written]:
    now = {}
    for record in records:
        written = before.get(record.id)
        if written is None or written.record is not record:
            parts = _Parts(written.parts if written is not None else {}, chunk, new)
            new.append(encode(without_arrays(record), parts))
            written = _Written(record, (chunk, len(new)), parts.used)
        now[record.id] = written
    return now


def _places(now: Mapping[int, _Written], before: Mapping[int, _Written]) -> dict[int, Place]:
    return {key: written.place for key, written in now.items() if before.get(key) is not written}
