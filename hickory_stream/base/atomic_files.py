"""Files that are either the old ones or the new ones, never half of each.

A file is written beside its place, synced and renamed. Only here errors of the disk become `MapFolderError`, so that a
full disk gives the same message everywhere.
"""

import errno
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hickory_stream.base.confined import OutsideError, open_new
from hickory_stream.errors import MapFolderError

PARTIAL_SUFFIX = ".partial"
_MOST_OPEN = 128

_ADVICE = {
    errno.ENOSPC: "the disk is full; free space or choose another --out",
    errno.EDQUOT: "the disk quota is used up; free space or choose another --out",
    errno.EFBIG: "the file grew beyond what the disk allows; choose another --out",
    errno.EACCES: "no permission; choose a folder that you may write to",
    errno.EPERM: "no permission; choose a folder that you may write to",
    errno.EROFS: "the file system is read-only; choose another --out",
    errno.ELOOP: "it is a link, which is not followed; replace it by what it points to",
    errno.ENOTDIR: "a part of the path is a file; choose another --out",
}


@contextmanager
def disk_errors(path: Path) -> Iterator[None]:
    """Turn an `OSError` within the block into a `MapFolderError` that names the path, the cause and the remedy."""
    try:
        yield
    except OSError as error:
        cause = error.strerror or type(error).__name__
        advice = _ADVICE.get(error.errno or 0, cause)
        raise MapFolderError(f"cannot write {error.filename or path}: {advice}") from error


@contextmanager
def outside_errors() -> Iterator[None]:
    """Turn an `OutsideError` within the block into a `MapFolderError`."""
    try:
        yield
    except OutsideError as error:
        raise MapFolderError(f"{error}: a map lies in its folder") from error


def link_or_copy(source: Path, target: Path) -> None:
    """Make the new file `target` a hard link, or a copy if the file system has none. Raises `OSError`."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)


def write_atomically(path: Path, data: bytes, *, sync: bool = True) -> None:
    """Replace the file `path` by `data`; without `sync` a killed process is harmless, a lost power supply is not.

    Raises `OSError`: the disk refused; the old file, if any, is untouched.
    """
    # Text costs a fifth of what path objects do, over thousands of small files.
    partial = _partial(path)
    try:
        _write_new(partial, data, syncs=sync)
        os.replace(partial, path)  # noqa: PTH105
    except OSError as error:
        Path(partial).unlink(missing_ok=True)
        raise _named(error, path)  # noqa: B904


class AtomicFiles:
    """New files that are written one by one, and synced side by side before any of them gets its name."""

    def __init__(self) -> None:
        self._paths: dict[Path, None] = {}

    def write(self, path: Path, data: bytes) -> None:
        """Write a file under a temporary name. Raises `OSError`: the disk refused."""
        self._paths[path] = None
        try:
            _write_new(_partial(path), data, syncs=False)
        except OSError as error:
            raise _named(error, path)  # noqa: B904

    def commit(self, others: Iterable[Path] = ()) -> None:
        """Sync all, and `others` that have their names, and name them. Raises `OSError`: the disk refused."""
        partials = [_partial(path) for path in self._paths]
        sync(*partials, *others)
        for partial, path in zip(partials, self._paths, strict=True):
            os.replace(partial, path)  # noqa: PTH105
        self._paths.clear()

    def __enter__(self) -> "AtomicFiles":
        return self

    def __exit__(self, *_: object) -> None:
        """Remove files that were not committed."""
        for path in self._paths:
            Path(_partial(path)).unlink(missing_ok=True)


def _partial(path: Path) -> str:
    folder, name = os.path.split(os.fspath(path))
    return os.path.join(folder, f".{name}{PARTIAL_SUFFIX}")  # noqa: PTH118


def _write_new(path: str, data: bytes, *, syncs: bool) -> None:
    with os.fdopen(open_new(path), "wb", buffering=0) as file:
        left = memoryview(data)
        while len(left):
            left = left[file.write(left) :]
        if syncs:
            os.fsync(file.fileno())


def _named(error: OSError, path: Path) -> OSError:
    # A failed write or sync does not say which file it was.
    error.filename = str(path) if error.filename is None else error.filename
    return error


def write_output(path: Path, data: bytes) -> None:
    """Write a requested file as a whole, or leave the old one. Pipes and devices are written directly, links followed.

    Raises `OSError`: the disk refused.
    """
    if path.exists() and not path.is_file():
        path.write_bytes(data)
    else:
        write_atomically(path.resolve(), data)


def sync(*paths: Path | str) -> None:
    """Wait until files, or the entries of folders, have reached the disk. Raises `OSError`.

    The disk writes many side by side: of 60 small files, that takes a third of the processor time of one by one.
    """
    for first in range(0, len(paths), _MOST_OPEN):
        descriptors: list[int] = []
        try:
            part = paths[first : first + _MOST_OPEN]
            # Only POSIX opens folders.
            descriptors.extend(_opened(path) for path in part if os.name == "posix" or not Path(path).is_dir())
            if len(descriptors) > 1 and hasattr(os, "posix_fadvise"):
                for descriptor in descriptors:
                    # Linux begins to write what is to be dropped.
                    os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            for descriptor in descriptors:
                os.fsync(descriptor)
        finally:
            for descriptor in descriptors:
                os.close(descriptor)


def _opened(path: Path | str) -> int:
    # In a foreign map, a link may lead out of it, and opening a pipe would block.
    flags, no_link = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0), getattr(os, "O_NOFOLLOW", 0)
    if os.name != "posix":
        flags |= os.O_RDWR  # others sync only what may be written
    if not no_link and Path(path).is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    try:
        return os.open(path, flags | no_link)
    except OSError as error:
        if error.errno != errno.ELOOP or not Path(path).is_dir():
            raise
        return os.open(path, flags)
