"""An opened map folder: the map as of its last complete save, and at earlier moments.

Points and space of a finished map are read on first use: its document has a seal, and names all other files by content.
Earlier moments need the core, imported on first use, which halves the time to open a map.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from hickory_stream.base.confined import read_within
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.codecs.mesh_file import mesh_of_file
from hickory_stream.geometry.mesh import Mesh, sha256_of
from hickory_stream.map_folder.codec import decode_snapshot, has_named_content
from hickory_stream.map_folder.digest import map_digest, seal_of
from hickory_stream.map_folder.layout import EMPTY, LEDGER, OBJECTS, SHAPES, TIMINGS, VIEWS, check_links
from hickory_stream.map_folder.manifest import Manifest, json_of, read_file, read_json, read_manifest

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from hickory_stream.map_folder.history.time_travel import Change
    from hickory_stream.records import MapSnapshot, ObjectShape

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, eq=False)
class SavedMap:
    """An opened map folder; `is_sealed`: the document belongs to the manifest's digest."""

    folder: Path
    manifest: Manifest
    snapshot: MapSnapshot
    ledger: Mapping[str, Any]
    timings: Mapping[str, float]
    is_sealed: bool

    @cached_property
    def digest(self) -> str:
        """The digest of the objects in the folder, independent of the manifest."""
        sealed = self.manifest.digest if self.is_sealed else None
        return map_digest(self.snapshot) if sealed is None else sealed

    @property
    def is_altered(self) -> bool:
        """Whether the objects differ from the manifest's digest, so that nothing of them is proven.

        A digest is no signature: a deliberate change can include it. `verify` proves the map again.
        """
        expected = self.manifest.digest
        return self.manifest.finished_cleanly if expected is None else expected != self.digest

    @property
    def doubt(self) -> str:
        """Why layer 4 may not be the proven one, in a sentence; "" if the digest is the manifest's."""
        if self.is_altered:
            expected = self.manifest.digest
            recorded = f"its manifest says {expected[:16]}" if expected is not None else "its manifest has none"
            found = f"its objects have the digest {self.digest[:16]}, {recorded}"
            return f"{self.folder} is not the map that was saved: {found}"
        if self.manifest.digest is None:
            return f"the run of {self.folder} has not finished, so that there is no digest to hold it against"
        return ""

    @property
    def views(self) -> Path:
        """The folder of kept views, for `read_crop`."""
        return self.folder / VIEWS

    def as_known_at(self, stamp_ns: int) -> MapSnapshot:
        """Return the core's map at a stamp, empty before the first keyframe.

        Raises `MapFolderError`: the journal is missing, damaged or of another version.
        """
        from hickory_stream.map_folder.history.time_travel import as_known_at

        return as_known_at(self.folder, stamp_ns)

    def at(self, stamp_ns: int) -> MapSnapshot:
        """Return the final map, restricted to objects and views seen by a stamp."""
        from hickory_stream.map_folder.history.time_travel import seen_by

        return seen_by(self.snapshot, stamp_ns)

    def diff(self, first_ns: int, second_ns: int) -> tuple[Change, ...]:
        """Return the changes of objects between the core's maps at two stamps.

        Raises `MapFolderError`: the journal is missing, damaged or of another version.
        """
        from hickory_stream.map_folder.history.time_travel import changes

        return changes(self.as_known_at(first_ns), self.as_known_at(second_ns))

    def mesh_path(self, shape: ObjectShape) -> Path:
        """Return the file of a shape's mesh (`geometry.mesh_file`)."""
        return self.folder / SHAPES / shape.mesh_name

    def mesh(self, shape: ObjectShape) -> Mesh:
        """Return the mesh of a shape, in the object frame. Raises `MapFolderError`: missing, damaged or another one."""
        path = self.mesh_path(shape)
        try:
            mesh = mesh_of_file(read_within(self.folder, f"{SHAPES}/{shape.mesh_name}"))
        except (OSError, ValueError) as error:
            raise MapFolderError(f"cannot read the mesh {path}: {error}; play the log again") from error
        if sha256_of(mesh) != shape.mesh_sha256:
            raise MapFolderError(f"{path} is not the mesh that the map was saved with; play the log again")
        return mesh


def open_map(path: Path, *, warns: bool = True, is_whole: bool = False) -> SavedMap:
    """Return the map in a folder as of its last complete save, empty before the first one.

    An altered map opens with a warning, unless `warns` is False: `is_altered`. Damaged files of a finished map are
    found on first use, with `is_whole` at once, without trust in the seal.

    Raises `MapFolderError`: there is no map, it has another format, or a file is missing or damaged.
    """
    manifest = read_manifest(path)
    check_links(path)
    snapshot, is_sealed = EMPTY, False
    if (path / OBJECTS).exists() or manifest.finished_cleanly:
        content = read_file(path, OBJECTS)
        is_sealed = not is_whole and manifest.digest is not None and manifest.seal == seal_of(manifest.digest, content)
        snapshot = _snapshot_of(path, content, is_whole=not is_sealed)
    saved = SavedMap(
        folder=path,
        manifest=manifest,
        snapshot=snapshot,
        ledger=read_json(path, LEDGER) if (path / LEDGER).exists() else {},
        timings=_read_timings(path) if (path / TIMINGS).exists() else {},
        is_sealed=is_sealed,
    )
    if saved.is_altered and warns:
        logger.warning("%s; `hickory-stream verify` says what of it holds", saved.doubt)
    return saved


def check_unaltered(saved: SavedMap, advice: str = "") -> None:
    """Raise `MapFolderError`, with the difference and `advice`, if a map was altered since its save."""
    if saved.is_altered:
        raise MapFolderError(f"{saved.doubt}; `hickory-stream verify {saved.folder}` says what of it holds{advice}")


def _read_timings(path: Path) -> dict[str, float]:
    timings = read_json(path, TIMINGS)
    wrong = [name for name, seconds in timings.items() if type(seconds) not in (int, float)]
    if wrong:
        raise MapFolderError(f"{path / TIMINGS} is damaged: {wrong[0]!r} is no number; play the log again")
    return timings


def _snapshot_of(path: Path, content: bytes, *, is_whole: bool) -> MapSnapshot:
    document = json_of(path, OBJECTS, content)

    def read(name: str) -> bytes:
        data = read_file(path, name)
        if not has_named_content(name, data):
            raise MapFolderError(f"{path / name} is damaged: its content is not what its name says; play the log again")
        return data

    try:
        snapshot = decode_snapshot(document, read, is_whole=is_whole)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        raise MapFolderError(f"{path / OBJECTS} is damaged: {error!r}; play the log again") from error
    for tracked in snapshot.objects:
        if tracked.shape and not (path / SHAPES / tracked.shape.mesh_name).is_file():
            raise MapFolderError(f"{path} lacks shapes/{tracked.shape.mesh_name} of object {tracked.id}")
    return snapshot
