"""The map folder: what `play` writes and every other command reads.

    MAP/
      manifest.json   format, software, config, source, `finished_cleanly`, and the digest once it is finished
      objects.json    the last saved snapshot; names the files in points/ and space/ by the hash of their content
      points/         layer 1 of each object, binary PLY
      space/          observed voxels of each submap, .npy
      views/          the pixels of the kept views: NAME.color.png, NAME.depth.png, NAME.json
      shapes/         layer 2 of each object, GLB
      jobs/           what shape workers are given and give back
      journal.mcap    all events, step by step, and the state of the core now and then
      failed/         the input of shape jobs that failed for good
      ledger.json     what became of every message and frame
      timings.json    seconds; in no digest

`objects.json` is replaced last and what it no longer names is removed after that: killed at any byte, the folder opens
as of its last complete save. No pickle is written or read.
"""

from __future__ import annotations

import logging
import shutil
from collections import deque
from dataclasses import dataclass, replace
from threading import Lock
from typing import TYPE_CHECKING, Any, Literal

from hickory_stream.confined import read_within, refuse_links
from hickory_stream.engine.atomic import PARTIAL_SUFFIX, disk_errors, outside_errors, sync, write_atomically
from hickory_stream.engine.crops import crop_files
from hickory_stream.engine.digest import map_digest
from hickory_stream.engine.folder_lock import LOCK, FolderLock, check_unlocked
from hickory_stream.engine.journal import JOURNAL
from hickory_stream.engine.manifest import (
    MANIFEST,
    Manifest,
    is_map_folder,
    manifest_json,
    pretty_json,
    read_file,
    read_json,
    read_manifest,
)
from hickory_stream.engine.map_codec import POINTS, SPACE, decode_snapshot, encode_snapshot, has_named_content
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.mesh import mesh_of_glb, sha256_of
from hickory_stream.json_text import dumps_exactly
from hickory_stream.records import MapSnapshot

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from hickory_stream.engine.time_travel import Change
    from hickory_stream.geometry.mesh import Mesh
    from hickory_stream.records import ObjectShape

logger = logging.getLogger(__name__)

_OBJECTS, _LEDGER, _TIMINGS = "objects.json", "ledger.json", "timings.json"
_FILES = (_OBJECTS, _LEDGER, _TIMINGS, JOURNAL)
_FOLDERS = (POINTS, SPACE, "views", "shapes", "jobs", "failed")
_EMPTY = MapSnapshot(revision=0, stamp_ns=0, submaps=(), objects=())


def create_map_folder(
    path: Path,
    *,
    config: Mapping[str, Any],
    source: Mapping[str, Any],
    run: Mapping[str, Any] | None = None,
    extractor: str = "",
    processor: str = "",
    overwrite: bool = False,
) -> MapFolder:
    """Return a new, empty map folder; `overwrite` replaces a map that is there, but never anything else.

    `config`, `source` (e.g. `asdict` of the `SourceInfo`) and `run` must be made of what JSON knows; `extractor`
    names what makes the features, `processor` the kind that the map depends on. The map of a `run` has a journal from
    its first moment, an empty one: a run that is killed at once can be gone on with. The folder is locked until it is
    closed.

    Raises:
        MapFolderError: the place is taken or cannot be written; nothing is left behind.
    """
    _check_place(path, overwrite)
    manifest = Manifest(config=config, source=source, run=run or {}, extractor=extractor, processor=processor)
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    with disk_errors(path):
        try:
            path.mkdir(parents=True, exist_ok=True)
            lock = FolderLock(path)
        except OSError:
            if missing:
                shutil.rmtree(missing[-1], ignore_errors=True)
            raise
        try:
            # Before the manifest, which promises one; and that of an earlier run is not to be taken for this one's.
            if run is not None:
                write_atomically(path / JOURNAL, b"")
            else:
                (path / JOURNAL).unlink(missing_ok=True)
            # Before all else, so that what a kill leaves is known for a map folder, opens, and can be overwritten.
            write_atomically(path / MANIFEST, manifest_json(manifest))
            _remove_map(path)
            for name in _FOLDERS:
                (path / name).mkdir(exist_ok=True)
            sync(path)
        except OSError:
            lock.release()
            if missing:
                shutil.rmtree(missing[-1], ignore_errors=True)
            raise
    return MapFolder(path, manifest, lock)


def reopen_map_folder(path: Path) -> MapFolder:
    """Return the map folder of a run that ended early, to be continued; locked until it is closed.

    Raises:
        MapFolderError: no map is there, its format is another, or another process writes it.
    """
    manifest = read_manifest(path)
    _check_links(path)
    with disk_errors(path):
        lock = FolderLock(path)
        try:
            for name in _FOLDERS:
                (path / name).mkdir(exist_ok=True)
            for partial in path.rglob(f".*{PARTIAL_SUFFIX}"):
                partial.unlink()
            saved = open_map(path)
        except BaseException:
            lock.release()
            raise
    return MapFolder(path, replace(manifest, finished_cleanly=False), lock, saved.snapshot)


class MapFolder:
    """A map folder being written, by one process, from any of its threads; `drop_...` never wait for the disk."""

    def __init__(
        self, path: Path, manifest: Manifest, lock: FolderLock | None = None, snapshot: MapSnapshot = _EMPTY
    ) -> None:
        self.path = path
        self.manifest = manifest
        self._folder_lock = lock
        self._last = snapshot
        self._shapes_to_keep: set[str] = set()
        self._on_disk: set[Path] = set()
        self._dropped: set[Path] = set()
        self._drop_requests: deque[Path] = deque()
        self._lock = Lock()

    @property
    def views(self) -> Path:
        """The folder of the kept views' pixels, for `write_crop` and `read_crop`."""
        return self.path / "views"

    @property
    def shapes(self) -> Path:
        """The folder of the meshes."""
        return self.path / "shapes"

    @property
    def jobs(self) -> Path:
        """The folder in which shape jobs are handed over."""
        return self.path / "jobs"

    def save(self, snapshot: MapSnapshot) -> None:
        """Make `snapshot` what the folder opens as; only what changed since the last save is written.

        Raises:
            MapFolderError: the disk refused; the folder opens as of the save before.
        """
        document, files = encode_snapshot(snapshot)
        with self._lock, disk_errors(self.path):
            if self.manifest.digest is not None:
                # That of the run that is continued: killed from here on, the folder has another map.
                self.manifest = replace(self.manifest, digest=None, finished_cleanly=False)
                write_atomically(self.path / MANIFEST, manifest_json(self.manifest))
            self._write_missing(files)
            self._sync_referenced(snapshot)
            write_atomically(self.path / _OBJECTS, dumps_exactly(document).encode())
            sync(self.path)
            self._last = snapshot
            self._remove_unreferenced(set(files))
            self._remove_dropped()

    def drop_view(self, name: str) -> None:
        """Remove a view's pixels once the saved map does not refer to them."""
        self._drop_requests.extend(crop_files(self.views, name))

    def keep_views(self, names: Iterable[str]) -> set[str]:
        """Remove these views' pixels no more, though that was asked for; return those that are gone already."""
        with self._lock:
            while self._drop_requests:
                self._dropped.add(self._drop_requests.popleft())
            files = {name: crop_files(self.views, name) for name in names}
            self._dropped.difference_update(*files.values())
            return {name for name, paths in files.items() if not all(path.exists() for path in paths)}

    def keep_shape(self, mesh_name: str) -> None:
        """Never remove a mesh: the map was known to have it at some moment."""
        self._shapes_to_keep.add(mesh_name)

    def write_json(self, name: Literal["ledger.json", "timings.json"], data: Any) -> None:
        """Replace a file beside the map by `data`, which JSON must know.

        Raises:
            MapFolderError: the disk refused; the old file is untouched.
        """
        with disk_errors(self.path):
            write_atomically(self.path / name, pretty_json(data))

    def finish(self, *, finished_cleanly: bool, is_reproducible: bool = True) -> Manifest:
        """Note the map's digest and how the run ended, and remove what a clean end left unreferenced.

        Raises:
            MapFolderError: the disk refused; the map opens as not finished.
        """
        self.manifest = replace(
            self.manifest,
            finished_cleanly=finished_cleanly,
            is_reproducible=is_reproducible,
            digest=map_digest(self._last),
        )
        with self._lock, disk_errors(self.path):
            if finished_cleanly:
                past = {self.shapes / name for name in self._shapes_to_keep}
                self._dropped.update(self.views.iterdir(), set(self.shapes.iterdir()) - past)
            self._remove_dropped()
            if not (self.path / _OBJECTS).exists():
                document, _ = encode_snapshot(self._last)
                write_atomically(self.path / _OBJECTS, dumps_exactly(document).encode())
            write_atomically(self.path / MANIFEST, manifest_json(self.manifest))
            sync(self.path)
        return self.manifest

    def close(self) -> None:
        """Let other processes write the folder."""
        if self._folder_lock is not None:
            self._folder_lock.release()

    def _write_missing(self, files: Mapping[str, bytes]) -> None:
        for name, data in files.items():
            if not (self.path / name).exists():
                write_atomically(self.path / name, data)
        sync(self.path / POINTS)
        sync(self.path / SPACE)

    def _sync_referenced(self, snapshot: MapSnapshot) -> None:
        """Bring to the disk what others wrote without waiting for it, before the map refers to it."""
        referenced = _referenced(self.path, snapshot)
        new = {path for path in referenced - self._on_disk if path.exists()}
        for path in new:
            sync(path)
        if new:
            sync(self.views)
            sync(self.shapes)
        self._on_disk = referenced & (self._on_disk | new)

    def _remove_unreferenced(self, names: set[str]) -> None:
        for folder in (POINTS, SPACE):
            for path in (self.path / folder).iterdir():
                if f"{folder}/{path.name}" not in names:
                    path.unlink()

    def _remove_dropped(self) -> None:
        while self._drop_requests:
            self._dropped.add(self._drop_requests.popleft())
        unreferenced = self._dropped - _referenced(self.path, self._last)
        for path in unreferenced:
            path.unlink(missing_ok=True)
        self._dropped -= unreferenced


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SavedMap:
    """A map folder as it was opened; `digest` is that of the objects in the folder, whatever the manifest says."""

    folder: Path
    manifest: Manifest
    snapshot: MapSnapshot
    ledger: Mapping[str, Any]
    timings: Mapping[str, float]
    digest: str

    @property
    def is_altered(self) -> bool:
        """Whether the objects are others than those of which the manifest has the digest: nothing of them is proven.

        A digest is no signature: who changes a map on purpose can change that, too. `engine.verify` proves it anew.
        """
        expected = self.manifest.digest
        return self.manifest.finished_cleanly if expected is None else expected != self.digest

    @property
    def doubt(self) -> str:
        """Why what the map says of its layer 4 may not hold, in a sentence; "" where its digest is as it must be."""
        if self.is_altered:
            expected = self.manifest.digest
            told = f"its manifest says {expected[:16]}" if expected is not None else "its manifest has none"
            return (
                f"{self.folder} is not the map that was saved: its objects have the digest {self.digest[:16]}, {told}"
            )
        if self.manifest.digest is None:
            return f"the run of {self.folder} has not finished, so that there is no digest to hold it against"
        return ""

    @property
    def views(self) -> Path:
        """The folder of the kept views' pixels, for `read_crop`."""
        return self.folder / "views"

    def as_known_at(self, stamp_ns: int) -> MapSnapshot:
        """Return the map exactly as the core held it at a stamp; an empty one before the first keyframe.

        Raises:
            MapFolderError: the journal is missing, damaged or of another version.
        """
        from hickory_stream.engine.time_travel import as_known_at

        return as_known_at(self.folder, stamp_ns)

    def at(self, stamp_ns: int) -> MapSnapshot:
        """Return what is known in the end, restricted to the objects and views that had been seen by a stamp."""
        from hickory_stream.engine.time_travel import seen_by

        return seen_by(self.snapshot, stamp_ns)

    def diff(self, first_ns: int, second_ns: int) -> tuple[Change, ...]:
        """Return what happened to the objects between two stamps, as the core knew them then.

        Raises:
            MapFolderError: the journal is missing, damaged or of another version.
        """
        from hickory_stream.engine.time_travel import changes

        return changes(self.as_known_at(first_ns), self.as_known_at(second_ns))

    def mesh_path(self, shape: ObjectShape) -> Path:
        """Return the GLB file of a shape."""
        return self.folder / "shapes" / shape.mesh_name

    def mesh(self, shape: ObjectShape) -> Mesh:
        """Return the mesh of a shape, in the object frame.

        Raises:
            MapFolderError: the file is missing, damaged or another one.
        """
        path = self.mesh_path(shape)
        try:
            mesh = mesh_of_glb(read_within(self.folder, f"shapes/{shape.mesh_name}"))
        except (OSError, ValueError) as error:
            raise MapFolderError(f"cannot read the mesh {path}: {error}; play the log again") from error
        if sha256_of(mesh) != shape.mesh_sha256:
            raise MapFolderError(f"{path} is not the mesh that the map was saved with; play the log again")
        return mesh


def open_map(path: Path, *, warns: bool = True) -> SavedMap:
    """Return the map in a folder as of its last complete save; a run that saved nothing yet is an empty map.

    A map that was altered since is opened all the same, with a warning unless `warns` is False: `is_altered`.

    Raises:
        MapFolderError: no map is there, its format is another, or a file is missing or damaged.
    """
    manifest = read_manifest(path)
    _check_links(path)
    if (path / _OBJECTS).exists() or manifest.finished_cleanly:
        snapshot = _read_snapshot(path)
    else:
        snapshot = _EMPTY
    saved = SavedMap(
        folder=path,
        manifest=manifest,
        snapshot=snapshot,
        ledger=read_json(path, _LEDGER) if (path / _LEDGER).exists() else {},
        timings=_read_timings(path) if (path / _TIMINGS).exists() else {},
        digest=map_digest(snapshot),
    )
    if saved.is_altered and warns:
        logger.warning("%s; `hickory-stream verify` says what of it holds", saved.doubt)
    return saved


def rewrite_objects(path: Path, snapshot: MapSnapshot, kept_meshes: Iterable[str]) -> str:
    """Save a map anew in its folder, as its run did, with the meshes of earlier moments kept; return the digest.

    Raises:
        MapFolderError: a mesh is missing, another process writes the folder, or the disk refused.
    """
    manifest = read_manifest(path)
    _check_links(path)
    for tracked in snapshot.objects:
        if tracked.shape is not None and not (path / "shapes" / tracked.shape.mesh_name).is_file():
            raise MapFolderError(f"{path} lacks shapes/{tracked.shape.mesh_name} of object {tracked.id}")
    with disk_errors(path):
        folder = MapFolder(path, manifest, FolderLock(path))
    try:
        for name in kept_meshes:
            folder.keep_shape(name)
        folder.save(snapshot)
        done = folder.finish(finished_cleanly=manifest.finished_cleanly, is_reproducible=manifest.is_reproducible)
        return done.digest or ""
    finally:
        folder.close()


def check_unaltered(saved: SavedMap, advice: str = "") -> None:
    """Refuse a map that is not the one that was saved; `advice` ends the message.

    Raises:
        MapFolderError: saying what disagrees, and what to do.
    """
    if saved.is_altered:
        raise MapFolderError(f"{saved.doubt}; `hickory-stream verify {saved.folder}` says what of it holds{advice}")


def _check_links(path: Path) -> None:
    """Refuse a map of which a part lies elsewhere: it would be read there, and by `resume` written there."""
    with outside_errors():
        refuse_links(path, (*_FOLDERS, *_FILES, MANIFEST, LOCK))


# ---- reading --------------------------------------------------------------------------------------------------------


def _read_timings(path: Path) -> dict[str, float]:
    timings = read_json(path, _TIMINGS)
    wrong = [name for name, seconds in timings.items() if type(seconds) not in (int, float)]
    if wrong:
        raise MapFolderError(f"{path / _TIMINGS} is damaged: {wrong[0]!r} is no number; play the log again")
    return timings


def _read_snapshot(path: Path) -> MapSnapshot:
    document = read_json(path, _OBJECTS)

    def read(name: str) -> bytes:
        data = read_file(path, name)
        if not has_named_content(name, data):
            raise MapFolderError(f"{path / name} is damaged: its content is not what its name says; play the log again")
        return data

    try:
        snapshot = decode_snapshot(document, read)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise MapFolderError(f"{path / _OBJECTS} is damaged: {error!r}; play the log again") from error
    for tracked in snapshot.objects:
        if tracked.shape and not (path / "shapes" / tracked.shape.mesh_name).is_file():
            raise MapFolderError(f"{path} lacks shapes/{tracked.shape.mesh_name} of object {tracked.id}")
    return snapshot


# ---- writing --------------------------------------------------------------------------------------------------------


def _check_place(path: Path, overwrite: bool) -> None:
    """Refuse a place that is taken.

    Raises:
        MapFolderError: naming what is there and what to do.
    """
    with disk_errors(path):
        if not path.exists():
            return
        if not path.is_dir():
            raise MapFolderError(f"{path} is a file; choose another --out")
        found = sorted(entry.name for entry in path.iterdir())
    if not found:
        return
    check_unlocked(path)
    is_map = is_map_folder(path)
    foreign = [name for name in found if not _is_ours(name)] if is_map else found
    if is_map and not overwrite:
        raise MapFolderError(f"{path} holds a map already; choose another --out, or --overwrite to replace it")
    if foreign:
        shown = ", ".join(foreign[:5]) + (f" and {len(foreign) - 5} more" if len(foreign) > 5 else "")
        raise MapFolderError(f"{path} holds files that are no map: {shown}; choose another --out")


def _is_ours(name: str) -> bool:
    return name in (MANIFEST, LOCK) or name in _FILES or name in _FOLDERS or name.endswith(PARTIAL_SUFFIX)


def _remove_map(path: Path) -> None:
    """Remove what a map folder holds beside its manifest, what it opens as first, and its journal."""
    for name in _FILES:
        if name != JOURNAL:
            (path / name).unlink(missing_ok=True)
    for name in _FOLDERS:
        if (path / name).exists():
            shutil.rmtree(path / name)


def _referenced(path: Path, snapshot: MapSnapshot) -> set[Path]:
    """Return the files of views and shapes that a snapshot refers to."""
    names = {view.name for tracked in snapshot.objects for view in tracked.views}
    files = {file for name in names for file in crop_files(path / "views", name)}
    return files | {path / "shapes" / tracked.shape.mesh_name for tracked in snapshot.objects if tracked.shape}
