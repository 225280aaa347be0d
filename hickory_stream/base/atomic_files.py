"""Files that are either the old ones or the new ones, never half of each.

A file is written beside its place, synced and renamed. Only here errors of the disk become `MapFolderError`, so that a
full disk gives the same message everywhere.
"""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hickory_stream.base.confined import OutsideError, open_new
from hickory_stream.errors import MapFolderError

PARTIAL_SUFFIX = ".partial"

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
    folder, name = os.path.split(os.fspath(path))
    partial = os.path.join(folder, f".{name}{PARTIAL_SUFFIX}")  # noqa: PTH118
    try:
        with os.fdopen(open_new(partial), "wb", buffering=0) as file:
            left = memoryview(data)
            while len(left):
                left = left[file.write(left) :]
            if sync:
                os.fsync(file.fileno())
        os.replace(partial, path)  # noqa: PTH105
    except OSError as error:
        Path(partial).unlink(missing_ok=True)
        if error.filename is None:  # a failed write or sync does not say which file it was
            error.filename = str(path)
        raise


def write_output(path: Path, data: bytes) -> None:
    """Write a requested file as a whole, or leave the old one. Pipes and devices are written directly, links followed.

    Raises `OSError`: the disk refused.
    """
    if path.exists() and not path.is_file():
        path.write_bytes(data)
    else:
        write_atomically(path.resolve(), data)


def sync(path: Path) -> None:
    """Wait until a file, or the entries of a folder, have reached the disk. Raises `OSError`."""
    if os.name != "posix" and path.is_dir():
        return  # only POSIX opens folders
    # In a foreign map, a link may lead out of it, and opening a pipe would block.
    flags, no_link = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0), getattr(os, "O_NOFOLLOW", 0)
    if not no_link and path.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    try:
        descriptor = os.open(path, flags | no_link)
    except OSError as error:
        if error.errno != errno.ELOOP or not path.is_dir():
            raise
        descriptor = os.open(path, flags)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
