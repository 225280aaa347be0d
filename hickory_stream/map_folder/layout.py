"""Names in a map folder (README.md has their content), where one may be made, and its lock.

`objects.json` is replaced last, and files that it no longer names are removed after that: a killed run's folder opens
as of its last complete save. No pickle is written or read. One process writes a folder; its lock ends with it.
"""

import os
import shutil
import sys
import weakref
from contextlib import suppress
from pathlib import Path

from hickory_stream.base.atomic_files import PARTIAL_SUFFIX, disk_errors, outside_errors
from hickory_stream.base.confined import refuse_links
from hickory_stream.errors import MapFolderError
from hickory_stream.journal.format import JOURNAL
from hickory_stream.map_folder.codec import POINTS, SPACE
from hickory_stream.map_folder.manifest import MANIFEST, is_map_folder
from hickory_stream.map_folder.views import crop_files
from hickory_stream.records import MapSnapshot, TrackedObject

LOCK = ".lock"


class FolderLock:
    """Locks a folder from construction until `release`, or the end of the process.

    Raises `MapFolderError`: another process holds it; `OSError`: the disk refused.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        while True:
            # No link is followed: the file is emptied below.
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
            if not _take(descriptor):
                holder = os.read(descriptor, 32).decode(errors="replace").strip() or "unknown"
                os.close(descriptor)
                raise MapFolderError(
                    f"{folder} is being written by process {holder}; wait for it, end it, or choose another folder"
                )
            # The last holder may have removed the file between our opening and our locking it.
            if self._path.exists() and self._path.stat().st_ino == os.fstat(descriptor).st_ino:
                break
            os.close(descriptor)
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
        self._release = weakref.finalize(self, _unlock, self._path, descriptor)

    def release(self) -> None:
        """Unlock the folder."""
        self._release()


def check_unlocked(folder: Path) -> None:
    """Raise `MapFolderError`, with the process, if another process writes a folder."""
    if (folder / LOCK).exists() and os.access(folder / LOCK, os.W_OK):
        FolderLock(folder).release()


def _unlock(path: Path, descriptor: int) -> None:
    with suppress(OSError):
        path.unlink()
    os.close(descriptor)


def _take(descriptor: int) -> bool:
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


OBJECTS, LEDGER, TIMINGS = "objects.json", "ledger.json", "timings.json"
VIEWS, SHAPES, JOBS = "views", "shapes", "jobs"
FILES = (OBJECTS, LEDGER, TIMINGS, JOURNAL)
FOLDERS = (POINTS, SPACE, VIEWS, SHAPES, JOBS, "failed")
EMPTY = MapSnapshot(revision=0, stamp_ns=0, submaps=(), objects=())


def check_links(path: Path) -> None:
    """Refuse a map with links to other places, where it would be read, and written by `resume`."""
    with outside_errors():
        refuse_links(path, (*FOLDERS, *FILES, MANIFEST, LOCK))


def check_place(path: Path, overwrite: bool) -> None:
    """Raise `MapFolderError`, with what to do, if a place is taken."""
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
    own = {MANIFEST, LOCK, *FILES, *FOLDERS} if is_map else set()
    foreign = [name for name in found if name not in own and not (is_map and name.endswith(PARTIAL_SUFFIX))]
    if is_map and not overwrite:
        raise MapFolderError(f"{path} holds a map already; choose another --out, or --overwrite to replace it")
    if foreign:
        shown = ", ".join(foreign[:5]) + (f" and {len(foreign) - 5} more" if len(foreign) > 5 else "")
        raise MapFolderError(f"{path} holds files that are no map: {shown}; choose another --out")


def remove_map(path: Path) -> None:
    """Remove the content of a map folder except its manifest: first the document, then the journal."""
    for name in FILES:
        if name != JOURNAL:
            (path / name).unlink(missing_ok=True)
    for name in FOLDERS:
        if (path / name).exists():
            shutil.rmtree(path / name)


def named_by(tracked: TrackedObject) -> frozenset[str]:
    """Return the names, below the map folder, of an object's views and mesh."""
    names = frozenset(f"{VIEWS}/{view.name}" for view in tracked.views)
    return names if tracked.shape is None else names | {f"{SHAPES}/{tracked.shape.mesh_name}"}


def files_of_name(path: Path, name: str) -> tuple[Path, ...]:
    """Return the files of a view or a mesh by its name below the map folder."""
    folder, _, plain = name.partition("/")
    return crop_files(path / VIEWS, plain) if folder == VIEWS else (path / folder / plain,)
