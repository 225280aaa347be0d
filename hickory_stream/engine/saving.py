"""Saving one snapshot after another: what a save costs is what has changed since the last one.

Records of a map never change: where an object or a submap is the one that was saved last, so are its part of the
document and its files.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hickory_stream.engine.folder_layout import named_by
from hickory_stream.engine.map_codec import encode_graph, encode_object, encode_points, encode_space, encode_submap
from hickory_stream.geometry.made_arrays import are_made_alike
from hickory_stream.json_text import dumps_exactly
from hickory_stream.records import Submap, TrackedObject

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from hickory_stream.records import MapSnapshot

    Write = Callable[[str, bytes], None]

R = TypeVar("R", Submap, TrackedObject)


@dataclass(frozen=True, kw_only=True, slots=True)
class EncodedSnapshot:
    """A snapshot as it is written: its `document`, and the names of files that it has no more."""

    document: bytes
    gone: frozenset[str]


class SnapshotEncoder:
    """Encodes snapshots as `encode_snapshot` does, one after another."""

    def __init__(self) -> None:
        self._objects: dict[int, _Entry[TrackedObject]] = {}
        self._submaps: dict[int, _Entry[Submap]] = {}

    def encoded(self, snapshot: MapSnapshot, write: Write) -> EncodedSnapshot:
        """Return what is to be written of a snapshot; the last one that was encoded is on the disk.

        `write` is given the name and the content of each new file, one after another: where a whole map has moved,
        they are not all in memory at once.
        """
        before: list[_Entry[Any]] = [*self._submaps.values(), *self._objects.values()]
        self._submaps = _entries(self._submaps, snapshot.submaps, _submap_entry, write)
        self._objects = _entries(self._objects, snapshot.objects, _object_entry, write)
        after: list[_Entry[Any]] = [*self._submaps.values(), *self._objects.values()]
        gone = {name for entry in _others(before, after) for name in entry.files}
        # Of an object that was encoded anew the same points may have stayed.
        gone -= {name for entry in _others(after, before) for name in entry.files}
        parts = [
            f'"revision": {int(snapshot.revision)}',
            f'"stamp_ns": {int(snapshot.stamp_ns)}',
            f'"submaps": [{", ".join(entry.text for entry in self._submaps.values())}]',
            f'"objects": [{", ".join(entry.text for entry in self._objects.values())}]',
        ]
        if snapshot.graph is not None:
            parts.append(f'"graph": {dumps_exactly(encode_graph(snapshot.graph))}')
        return EncodedSnapshot(document=f"{{{', '.join(parts)}}}".encode(), gone=frozenset(gone))

    @property
    def files(self) -> set[str]:
        """The names of all files of the last snapshot."""
        entries: list[_Entry[Any]] = [*self._submaps.values(), *self._objects.values()]
        return {name for entry in entries for name in entry.files}


class ReferencedNames:
    """The views and meshes that a snapshot refers to, by their names below the map folder."""

    def __init__(self) -> None:
        self._names: dict[int, tuple[TrackedObject, frozenset[str]]] = {}
        self._num: Counter[str] = Counter()

    def __contains__(self, name: object) -> bool:
        return name in self._num

    def __iter__(self) -> Iterator[str]:
        return iter(self._num)

    def follow(self, snapshot: MapSnapshot) -> list[str]:
        """Take up a snapshot; return the names that the last one did not refer to."""
        before, self._names = self._names, {}
        new: list[str] = []
        for tracked in snapshot.objects:
            known = before.pop(tracked.id, None)
            if known is not None and known[0] is tracked:
                self._names[tracked.id] = known
                continue
            names = named_by(tracked)
            self._names[tracked.id] = (tracked, names)
            old = known[1] if known is not None else frozenset()
            for name in names - old:
                if name not in self._num:
                    new.append(name)
                self._num[name] += 1
            self._let_go(old - names)
        for _, names in before.values():
            self._let_go(names)
        return new

    def _let_go(self, names: Iterable[str]) -> None:
        for name in names:
            self._num[name] -= 1
            if not self._num[name]:
                del self._num[name]


@dataclass(frozen=True, slots=True, eq=False)
class _Entry(Generic[R]):
    """A record, its part of the document, and the files that this names."""

    record: R
    text: str
    files: tuple[str, ...]


def _entries(
    known: Mapping[int, _Entry[R]],
    records: Sequence[R],
    encode: Callable[[R, _Entry[R] | None, dict[str, bytes]], _Entry[R]],
    write: Write,
) -> dict[int, _Entry[R]]:
    entries = {}
    for record in records:
        entry = known.get(record.id)
        if entry is None or entry.record is not record:
            files: dict[str, bytes] = {}
            entry = encode(record, entry, files)
            for name, data in files.items():
                write(name, data)
        entries[record.id] = entry
    return entries


def _submap_entry(submap: Submap, known: _Entry[Submap] | None, files: dict[str, bytes]) -> _Entry[Submap]:
    # A submap that was moved has its voxels where they were.
    has_same_space = known is not None and known.record.observed_space is submap.observed_space
    names = known.files if known is not None and has_same_space else encode_space(submap, files)
    return _Entry(submap, dumps_exactly(encode_submap(submap, names)), names)


def _object_entry(
    tracked: TrackedObject, known: _Entry[TrackedObject] | None, files: dict[str, bytes]
) -> _Entry[TrackedObject]:
    has_same_points = known is not None and are_made_alike(known.record, tracked)
    points = known.files[0] if known is not None and has_same_points else encode_points(tracked, files)
    return _Entry(tracked, dumps_exactly(encode_object(tracked, points)), (points,))


def _others(entries: Iterable[_Entry[Any]], than: Iterable[_Entry[Any]]) -> list[_Entry[Any]]:
    same = {id(entry) for entry in than}
    return [entry for entry in entries if id(entry) not in same]
