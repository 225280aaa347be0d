"""Saving one snapshot after another: what a save costs is what has changed since the last one.

Records of a map never change: where an object or a submap is the one that was saved last, so are its part of the
document and its files.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hickory_stream.engine.folder_layout import named_by
from hickory_stream.engine.map_codec import encode_graph, encode_object, encode_submap
from hickory_stream.json_text import dumps_exactly
from hickory_stream.records import Submap

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from hickory_stream.engine.map_codec import Json
    from hickory_stream.records import MapSnapshot, TrackedObject


@dataclass(frozen=True, kw_only=True, slots=True)
class EncodedSnapshot:
    """A snapshot as it is written: its `document`, the `new` files by name, and the names that it has no more."""

    document: bytes
    new: Mapping[str, bytes]
    gone: frozenset[str]


class SnapshotEncoder:
    """Encodes snapshots as `encode_snapshot` does, one after another."""

    def __init__(self) -> None:
        self._objects: dict[int, _Entry] = {}
        self._submaps: dict[int, _Entry] = {}

    def encoded(self, snapshot: MapSnapshot) -> EncodedSnapshot:
        """Return what is to be written of a snapshot; the last one that was encoded is on the disk."""
        new: dict[str, bytes] = {}
        before = [*self._submaps.values(), *self._objects.values()]
        self._submaps = _entries(self._submaps, snapshot.submaps, new)
        self._objects = _entries(self._objects, snapshot.objects, new)
        after = [*self._submaps.values(), *self._objects.values()]
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
        return EncodedSnapshot(document=f"{{{', '.join(parts)}}}".encode(), new=new, gone=frozenset(gone))

    @property
    def files(self) -> set[str]:
        """The names of all files of the last snapshot."""
        return {name for entry in (*self._submaps.values(), *self._objects.values()) for name in entry.files}


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
class _Entry:
    """A record, its part of the document, and the files that this names."""

    record: Submap | TrackedObject
    text: str
    files: tuple[str, ...]


def _entries(
    known: Mapping[int, _Entry], records: Sequence[Submap] | Sequence[TrackedObject], new: dict[str, bytes]
) -> dict[int, _Entry]:
    entries = {}
    for record in records:
        entry = known.get(record.id)
        if entry is None or entry.record is not record:
            files: dict[str, bytes] = {}
            entry = _Entry(record, dumps_exactly(_json(record, files)), tuple(files))
            new |= files
        entries[record.id] = entry
    return entries


def _json(record: Submap | TrackedObject, files: dict[str, bytes]) -> Json:
    return encode_submap(record, files) if isinstance(record, Submap) else encode_object(record, files)


def _others(entries: Iterable[_Entry], than: Iterable[_Entry]) -> list[_Entry]:
    same = {id(entry) for entry in than}
    return [entry for entry in entries if id(entry) not in same]
