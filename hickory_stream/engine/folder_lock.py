"""One process writes a map folder: a lock that ends with its process, however that ends, and says who holds it."""

from __future__ import annotations

import os
import sys
import weakref
from contextlib import suppress
from typing import TYPE_CHECKING

from hickory_stream.errors import MapFolderError

if TYPE_CHECKING:
    from pathlib import Path

LOCK = ".lock"


class FolderLock:
    """Holds a folder from construction until `release`, or the end of the process.

    Raises:
        MapFolderError: another process holds it.
        OSError: the disk refused.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / LOCK
        while True:
            # A link in its place, which somebody's folder may hold, is not followed: the file is emptied below.
            descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o644)
            if not _take(descriptor):
                holder = os.read(descriptor, 32).decode(errors="replace").strip() or "unknown"
                os.close(descriptor)
                raise MapFolderError(
                    f"{folder} is being written by process {holder}; wait for it, end it, or choose another folder"
                )
            # Whoever held it may have removed the file between our opening and our locking it.
            if self._path.exists() and self._path.stat().st_ino == os.fstat(descriptor).st_ino:
                break
            os.close(descriptor)
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"{os.getpid()}\n".encode())
        # A folder that is forgotten is not held on to.
        self._release = weakref.finalize(self, _let_go, self._path, descriptor)

    def release(self) -> None:
        """Let others write the folder."""
        self._release()


def check_unlocked(folder: Path) -> None:
    """Refuse a folder that another process writes.

    Raises:
        MapFolderError: naming the process.
    """
    if (folder / LOCK).exists() and os.access(folder / LOCK, os.W_OK):
        FolderLock(folder).release()


def _let_go(path: Path, descriptor: int) -> None:
    with suppress(OSError):
        path.unlink()
    os.close(descriptor)


def _take(descriptor: int) -> bool:
    """Lock an open file; return whether nobody else has."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
