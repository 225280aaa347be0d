"""A map folder while one process writes it: created, continued, saved and finished.

`objects.json` is replaced last, and files that it no longer names are removed after that. A save costs as much as has
changed: unchanged records keep their part of the document and their files.
"""

import shutil
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Generic, Literal, TypeVar

from hickory_stream.base.atomic_files import PARTIAL_SUFFIX, AtomicFiles, disk_errors, sync, write_atomically
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.lazy_arrays import are_made_alike
from hickory_stream.journal.format import JOURNAL
from hickory_stream.map_folder import codec, layout
from hickory_stream.map_folder.digest import map_digest, seal_of
from hickory_stream.map_folder.manifest import MANIFEST, Manifest, manifest_json, pretty_json, read_manifest
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.map_folder.views import crop_files
from hickory_stream.records import MapSnapshot, Submap, TrackedObject

Write = Callable[[str, bytes], None]

R = TypeVar("R", Submap, TrackedObject)


@dataclass(frozen=True, kw_only=True, slots=True)
class EncodedSnapshot:
    """An encoded snapshot."""

    document: bytes
    #: Files that it no longer names.
    gone: frozenset[str]


class SnapshotEncoder:
    """Encodes consecutive snapshots like `encode_snapshot`."""

    def __init__(self) -> None:
        self._objects: dict[int, _Entry[TrackedObject]] = {}
        self._submaps: dict[int, _Entry[Submap]] = {}

    def encoded(self, snapshot: MapSnapshot, write: Write) -> EncodedSnapshot:
        """Return an encoded snapshot; the one before is on the disk.

        `write` receives name and content of each new file in turn: a map that moved is never in memory as a whole.
        """
        before = self._entries
        self._submaps = _entries(self._submaps, snapshot.submaps, _submap_entry, write)
        self._objects = _entries(self._objects, snapshot.objects, _object_entry, write)
        after = self._entries
        gone = {name for entry in _others(before, after) for name in entry.files}
        # A changed object may have its old points.
        gone -= {name for entry in _others(after, before) for name in entry.files}
        parts = [
            f'"revision": {int(snapshot.revision)}',
            f'"stamp_ns": {int(snapshot.stamp_ns)}',
            f'"submaps": [{", ".join(entry.text for entry in self._submaps.values())}]',
            f'"objects": [{", ".join(entry.text for entry in self._objects.values())}]',
        ]
        if snapshot.graph is not None:
            parts.append(f'"graph": {dumps_exactly(codec.encode_graph(snapshot.graph))}')
        return EncodedSnapshot(document=f"{{{', '.join(parts)}}}".encode(), gone=frozenset(gone))

    @property
    def files(self) -> set[str]:
        """All files of the last snapshot."""
        return {name for entry in self._entries for name in entry.files}

    @property
    def _entries(self) -> "list[_Entry[Any]]":
        return [*self._submaps.values(), *self._objects.values()]


class ReferencedNames:
    """Names, below the map folder, of the views and meshes of a snapshot."""

    def __init__(self) -> None:
        self._names: dict[int, tuple[TrackedObject, frozenset[str]]] = {}
        self._num: Counter[str] = Counter()

    def __contains__(self, name: object) -> bool:
        return name in self._num

    def __iter__(self) -> Iterator[str]:
        return iter(self._num)

    def follow(self, snapshot: MapSnapshot) -> list[str]:
        """Advance to a snapshot; return its new names."""
        before, self._names = self._names, {}
        new: list[str] = []
        for tracked in snapshot.objects:
            known = before.pop(tracked.id, None)
            if known is not None and known[0] is tracked:
                self._names[tracked.id] = known
                continue
            names = layout.named_by(tracked)
            self._names[tracked.id] = (tracked, names)
            old = known[1] if known is not None else frozenset()
            for name in names - old:
                if name not in self._num:
                    new.append(name)
                self._num[name] += 1
            self._remove(old - names)
        for _, names in before.values():
            self._remove(names)
        return new

    def _remove(self, names: Iterable[str]) -> None:
        for name in names:
            self._num[name] -= 1
            if not self._num[name]:
                del self._num[name]


@dataclass(frozen=True, slots=True, eq=False)
class _Entry(Generic[R]):
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
    is_same = known is not None and known.record.observed_space is submap.observed_space
    names = known.files if known is not None and is_same else codec.encode_space(submap, files)
    return _Entry(submap, dumps_exactly(codec.encode_submap(submap, names)), names)


def _object_entry(
    tracked: TrackedObject, known: _Entry[TrackedObject] | None, files: dict[str, bytes]
) -> _Entry[TrackedObject]:
    is_same = known is not None and are_made_alike(known.record, tracked)
    points = known.files[0] if known is not None and is_same else codec.encode_points(tracked, files)
    return _Entry(tracked, dumps_exactly(codec.encode_object(tracked, points)), (points,))


def _others(entries: Iterable[_Entry[Any]], than: Iterable[_Entry[Any]]) -> list[_Entry[Any]]:
    same = {id(entry) for entry in than}
    return [entry for entry in entries if id(entry) not in same]


def create_map_folder(
    path: Path,
    *,
    config: Mapping[str, Any],
    source: Mapping[str, Any],
    run: Mapping[str, Any] | None = None,
    extractor: str = "",
    processor: str = "",
    overwrite: bool = False,
) -> "MapFolder":
    """Return a new, empty map folder, locked until it is closed; `overwrite` replaces an existing map, nothing else.

    `config`, `source` (e.g. `asdict` of the `SourceInfo`) and `run` must be JSON; `extractor` makes the features,
    `processor` is the kind that the map depends on. The map of a `run` has an empty journal at once, so that any kill
    can be resumed.

    Raises `MapFolderError`: the place is taken or cannot be written; nothing is left behind.
    """
    layout.check_place(path, overwrite)
    manifest = Manifest(config=config, source=source, run=run or {}, extractor=extractor, processor=processor)
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    with disk_errors(path):
        try:
            path.mkdir(parents=True, exist_ok=True)
            lock = layout.FolderLock(path)
        except OSError:
            if missing:
                shutil.rmtree(missing[-1], ignore_errors=True)
            raise
        try:
            # Before the manifest, which promises one.
            if run is not None:
                write_atomically(path / JOURNAL, b"")
            else:
                (path / JOURNAL).unlink(missing_ok=True)
            # Before all else: what a kill leaves is a map folder that opens and can be overwritten.
            write_atomically(path / MANIFEST, manifest_json(manifest))
            layout.remove_map(path)
            for name in layout.FOLDERS:
                (path / name).mkdir(exist_ok=True)
            sync(path)
        except OSError:
            lock.release()
            if missing:
                shutil.rmtree(missing[-1], ignore_errors=True)
            raise
    return MapFolder(path, manifest, lock)


def reopen_map_folder(path: Path) -> "MapFolder":
    """Return the map folder of an interrupted run, to be continued; locked until it is closed.

    Raises `MapFolderError`: there is no map, it has another format, or another process writes it.
    """
    manifest = read_manifest(path)
    layout.check_links(path)
    with disk_errors(path):
        lock = layout.FolderLock(path)
        try:
            for name in layout.FOLDERS:
                (path / name).mkdir(exist_ok=True)
            for partial in path.rglob(f".*{PARTIAL_SUFFIX}"):
                partial.unlink()
            saved = open_map(path, is_whole=True)
        except BaseException:
            lock.release()
            raise
    return MapFolder(path, replace(manifest, finished_cleanly=False), lock, saved.snapshot)


class MapFolder:
    """A map folder being written by one process, from any thread; `drop_...` never wait for the disk."""

    def __init__(
        self,
        path: Path,
        manifest: Manifest,
        lock: layout.FolderLock | None = None,
        snapshot: MapSnapshot = layout.EMPTY,
    ) -> None:
        self.path = path
        self.manifest = manifest
        self._folder_lock = lock
        self._last = snapshot
        self._encoder = SnapshotEncoder()
        self._referenced = ReferencedNames()
        self._unsynced = set(self._referenced.follow(snapshot))
        self._is_swept = False
        self._shapes_to_keep: set[str] = set()
        self._dropped: set[str] = set()
        self._drop_requests: deque[str] = deque()
        self._lock = Lock()

    @property
    def views(self) -> Path:
        """The folder of kept views, for `write_crop` and `read_crop`."""
        return self.path / layout.VIEWS

    @property
    def shapes(self) -> Path:
        """The folder of the meshes."""
        return self.path / layout.SHAPES

    @property
    def jobs(self) -> Path:
        """The folder of shape jobs."""
        return self.path / layout.JOBS

    def save(self, snapshot: MapSnapshot) -> None:
        """Save a snapshot; only changes are written.

        Raises `MapFolderError`: the disk refused; the folder opens as of the save before.
        """
        with self._lock, disk_errors(self.path), AtomicFiles() as new:
            # The next save does not build on one that failed.
            encoder, self._encoder, was_swept, self._is_swept = self._encoder, SnapshotEncoder(), self._is_swept, False
            if self.manifest.digest is not None:
                # The digest of the continued run: from here on, the folder has another map.
                self.manifest = replace(self.manifest, digest=None, seal="", finished_cleanly=False)
                write_atomically(self.path / MANIFEST, manifest_json(self.manifest))
            folders: set[str] = set()
            encoded = encoder.encoded(snapshot, partial(self._write_missing, new, folders))
            unsynced = self._unsynced_files(snapshot)
            paths = [path for name in sorted(unsynced) for path in unsynced[name] if path.exists()]
            new.commit(paths)
            sync(*sorted({self.path / folder for folder in folders} | {path.parent for path in paths}))
            self._unsynced = {name for name in self._unsynced - unsynced.keys() if name in self._referenced}
            write_atomically(self.path / layout.OBJECTS, encoded.document)
            sync(self.path)
            self._last, self._encoder, self._is_swept = snapshot, encoder, was_swept
            self._remove_unreferenced(encoded.gone)
            self._remove_dropped()

    def drop_view(self, name: str) -> None:
        """Remove a view's pixels once the saved map does not refer to them."""
        self._drop_requests.append(f"{layout.VIEWS}/{name}")

    def keep_views(self, names: Iterable[str]) -> set[str]:
        """Cancel the removal of these views' pixels; return views that are gone already."""
        with self._lock:
            self._take_requests()
            kept = set(names)
            self._dropped -= {f"{layout.VIEWS}/{name}" for name in kept}
            return {name for name in kept if not all(path.exists() for path in crop_files(self.views, name))}

    def keep_shape(self, mesh_name: str) -> None:
        """Keep a mesh for good: the map had it at some moment."""
        self._shapes_to_keep.add(mesh_name)

    def write_json(self, name: Literal["ledger.json", "timings.json"], data: Any) -> None:
        """Replace a file beside the map by JSON.

        Raises `MapFolderError`: the disk refused; the old file is untouched.
        """
        with disk_errors(self.path):
            write_atomically(self.path / name, pretty_json(data))

    def finish(self, *, finished_cleanly: bool, is_reproducible: bool = True) -> Manifest:
        """Record the map's digest and the end of the run, and remove files that a clean end left unreferenced.

        Raises `MapFolderError`: the disk refused; the map opens as not finished.
        """
        with self._lock, disk_errors(self.path):
            self._referenced.follow(self._last)
            if finished_cleanly:
                past = {self.shapes / name for name in self._shapes_to_keep}
                kept = past.union(*(layout.files_of_name(self.path, name) for name in self._referenced))
                for path in {*self.views.iterdir(), *self.shapes.iterdir()} - kept:
                    path.unlink(missing_ok=True)
            self._remove_dropped()
            if not (self.path / layout.OBJECTS).exists():
                document, _ = codec.encode_snapshot(self._last)
                write_atomically(self.path / layout.OBJECTS, dumps_exactly(document).encode())
            digest = map_digest(self._last)
            self.manifest = replace(
                self.manifest,
                finished_cleanly=finished_cleanly,
                is_reproducible=is_reproducible,
                digest=digest,
                seal=seal_of(digest, (self.path / layout.OBJECTS).read_bytes()),
            )
            write_atomically(self.path / MANIFEST, manifest_json(self.manifest))
            sync(self.path)
        return self.manifest

    def close(self) -> None:
        """Unlock the folder."""
        if self._folder_lock is not None:
            self._folder_lock.release()

    def _write_missing(self, new: AtomicFiles, folders: set[str], name: str, data: bytes) -> None:
        path = self.path / name
        if not path.exists():
            new.write(path, data)
        folders.add(name.partition("/")[0])

    def _unsynced_files(self, snapshot: MapSnapshot) -> dict[str, tuple[Path, ...]]:
        # Views are written without a sync; the map may refer to them only after one.
        self._unsynced.update(self._referenced.follow(snapshot))
        files = {name: layout.files_of_name(self.path, name) for name in self._unsynced}
        # The description of a view, the last of its files, is written last.
        return {name: paths for name, paths in files.items() if paths[-1].exists()}

    def _remove_unreferenced(self, gone: Iterable[str]) -> None:
        # The first time also files of others, or of a save that failed.
        for name in gone:
            (self.path / name).unlink(missing_ok=True)
        if not self._is_swept:
            names = self._encoder.files
            for folder in (codec.POINTS, codec.SPACE):
                for path in (self.path / folder).iterdir():
                    if f"{folder}/{path.name}" not in names:
                        path.unlink()
            self._is_swept = True

    def _take_requests(self) -> None:
        # `drop_view` appends to the queue without the lock.
        while self._drop_requests:
            self._dropped.add(self._drop_requests.popleft())

    def _remove_dropped(self) -> None:
        self._take_requests()
        unreferenced = {name for name in self._dropped if name not in self._referenced}
        for path in [path for name in unreferenced for path in layout.files_of_name(self.path, name)]:
            path.unlink(missing_ok=True)
        self._dropped -= unreferenced


def rewrite_objects(path: Path, snapshot: MapSnapshot, kept_meshes: Iterable[str]) -> str:
    """Save a map into its folder again, with the meshes of earlier moments; return the digest.

    Raises `MapFolderError`: a mesh is missing, another process writes the folder, or the disk refused.
    """
    manifest = read_manifest(path)
    layout.check_links(path)
    for tracked in snapshot.objects:
        if tracked.shape is not None and not (path / layout.SHAPES / tracked.shape.mesh_name).is_file():
            raise MapFolderError(f"{path} lacks shapes/{tracked.shape.mesh_name} of object {tracked.id}")
    with disk_errors(path):
        folder = MapFolder(path, manifest, layout.FolderLock(path))
    try:
        for name in kept_meshes:
            folder.keep_shape(name)
        folder.save(snapshot)
        done = folder.finish(finished_cleanly=manifest.finished_cleanly, is_reproducible=manifest.is_reproducible)
        return done.digest or ""
    finally:
        folder.close()
