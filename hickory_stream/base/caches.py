"""Caches of compiled kernels, shapes and recordings, which may be removed at any moment.

They lie in `$HICKORY_CACHE` or `hickory-stream` in the user's caches; if that cannot be written, in a temporary folder,
with one message. Beyond a cap in bytes, the least recently used entries are removed.
"""

import contextlib
import logging
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, get_args

from hickory_stream.errors import ConfigError

logger = logging.getLogger(__name__)

Kind = Literal["kernels", "shapes", "recordings", "true-shapes", "image-features"]
KINDS: tuple[Kind, ...] = get_args(Kind)
_DEFAULT_CAP_MB = 4000.0
# Below 1, so that not every call removes files.
_PRUNED_SHARE = 0.8
_TOUCH_EVERY_S = 3600.0


@dataclass(frozen=True, kw_only=True, slots=True)
class CacheEntry:
    """Files that are removed together, their bytes, and the time of their last use (seconds since 1970)."""

    kind: Kind
    paths: tuple[Path, ...]
    num_bytes: int
    used_s: float


def cache_folder(kind: Kind) -> Path:
    """Return the existing folder of a kind. Raises `ConfigError`: no folder can be written."""
    folder = cache_root() / kind
    with contextlib.suppress(OSError):  # a full disk: the first write reports it
        folder.mkdir(exist_ok=True)
    return folder


def cache_root() -> Path:
    """Return the folder of all caches, a temporary one if necessary. Raises `ConfigError`: no folder can be written."""
    return _usable_root(wanted_root())


def wanted_root() -> Path:
    """Return the configured folder: `$HICKORY_CACHE`, else in the user's caches."""
    named = os.environ.get("HICKORY_CACHE")
    if named:
        return Path(named).absolute()
    caches = os.environ.get("XDG_CACHE_HOME")
    if caches and Path(caches).is_absolute():
        return Path(caches) / "hickory-stream"
    try:
        return Path.home() / ".cache" / "hickory-stream"
    except RuntimeError:  # a user without an entry and without HOME
        return Path("/nonexistent/hickory-stream")


def cap_mb() -> float:
    """Return the cap in megabytes: `$HICKORY_CACHE_MB`, by default 4000.

    Raises `ConfigError`: it is negative or no number.
    """
    named = os.environ.get("HICKORY_CACHE_MB", "")
    if not named:
        return _DEFAULT_CAP_MB
    try:
        megabytes = float(named)
    except ValueError:
        megabytes = -1.0
    if not 0.0 <= megabytes < float("inf"):
        raise ConfigError(f"HICKORY_CACHE_MB is {named!r}, expected megabytes, 0 or more, e.g. 4000")
    return megabytes


def entries() -> Iterator[CacheEntry]:
    """Yield all entries."""
    for kind in KINDS:
        for paths in _GROUPS[kind](cache_root() / kind):
            with contextlib.suppress(OSError):  # another process has just removed it
                used_s = max(path.stat().st_mtime for path in paths)
                num_bytes = sum(_num_bytes(path) for path in paths)
                yield CacheEntry(kind=kind, paths=paths, num_bytes=num_bytes, used_s=used_s)


def _num_bytes(path: str | Path) -> int:
    # No `Path` for each of thousands of files.
    if not os.path.isdir(path):  # noqa: PTH112
        return os.stat(path).st_size  # noqa: PTH116
    with os.scandir(path) as found:
        return sum(
            _num_bytes(entry.path) if entry.is_dir(follow_symlinks=False) else entry.stat().st_size for entry in found
        )


def clear(kinds: Iterable[Kind] = KINDS) -> int:
    """Remove all entries of these kinds; return their bytes."""
    root, wanted = cache_root(), list(kinds)
    num_bytes = sum(entry.num_bytes for entry in entries() if entry.kind in wanted)
    for kind in wanted:
        shutil.rmtree(root / kind, ignore_errors=True)
    return num_bytes


def prune() -> int:
    """Remove the least recently used entries beyond the cap; return their bytes."""
    cap = cap_mb() * 1e6
    kept = sorted(entries(), key=lambda entry: entry.used_s)
    total = sum(entry.num_bytes for entry in kept)
    if total <= cap:
        return 0
    removed = 0
    for entry in kept:
        if total - removed <= _PRUNED_SHARE * cap:
            break
        for path in entry.paths:
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                with contextlib.suppress(OSError):
                    path.unlink(missing_ok=True)
        removed += entry.num_bytes
    return removed


def mark_used(*paths: Path) -> None:
    """Record the use of an entry, at most once an hour."""
    with contextlib.suppress(OSError):  # it is a cache
        for path in paths:
            if time.time() - path.stat().st_mtime > _TOUCH_EVERY_S:
                os.utime(path)


def _two_levels(folder: Path) -> Iterator[tuple[Path, ...]]:
    yield from ((path,) for path in sorted(folder.glob("*/*")))


def _by_stem(folder: Path) -> Iterator[tuple[Path, ...]]:
    # A log and its truth have one name up to the first dot.
    groups: dict[str, list[Path]] = {}
    for path in sorted(folder.glob("*")):
        groups.setdefault(path.name.lstrip(".").partition(".")[0], []).append(path)
    yield from (tuple(paths) for paths in groups.values())


_GROUPS = {
    "kernels": _two_levels,
    "shapes": _two_levels,
    "recordings": _by_stem,
    "true-shapes": _by_stem,
    "image-features": _two_levels,
}


@cache
def _usable_root(wanted: Path) -> Path:
    if (refusal := _refusal(wanted)) is None:
        return wanted
    found = _temporary_root()
    logger.warning(
        "caches cannot be kept in %s (%s): they go to %s; HICKORY_CACHE names another folder", wanted, refusal, found
    )
    return found


def _refusal(folder: Path) -> str | None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"0")
    except OSError as error:
        return error.strerror or type(error).__name__
    return None


def _temporary_root() -> Path:
    # Only this user can write it: what is read from it is executed.
    try:
        base = Path(tempfile.gettempdir())
        if os.name != "posix":
            folder = base / "hickory-stream"
            folder.mkdir(exist_ok=True)
            return folder
        folder = base / f"hickory-stream-{os.getuid()}"
        with contextlib.suppress(FileExistsError):
            folder.mkdir(mode=0o700)
        status = folder.lstat()
        is_ours = stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o022
        if is_ours and _refusal(folder) is None:
            return folder
        return Path(tempfile.mkdtemp(prefix="hickory-stream-"))
    except OSError as error:
        raise ConfigError(
            f"no folder can be written for caches, not even a temporary one ({error.strerror or error}); "
            "set HICKORY_CACHE or TMPDIR to one"
        ) from error
