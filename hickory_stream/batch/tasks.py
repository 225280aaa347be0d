"""A task of a batch, one log into one folder, and its outcome."""

from __future__ import annotations

import hashlib
import re
import sys
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from hickory_stream import __version__

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hickory_stream.config import MapperConfig
    from hickory_stream.sinks.disk_sink import DiskSinkConfig

_PACKAGES = ("hickory_stream", "players")
_LIBRARIES = ("numpy", "scipy", "numba", "opencv-python-headless", "scikit-image")
_NOT_IN_NAMES = re.compile(r"[^A-Za-z0-9_.-]+")

State = Literal["mapped", "failed", "disk full"]


@dataclass(frozen=True, kw_only=True, slots=True)
class LogTask:
    """One log: its `note` (`players.open_from_note`), its map folder, and its configuration."""

    name: str
    note: Mapping[str, Any]
    out: Path
    mapper: MapperConfig
    disk: DiskSinkConfig
    #: required version
    software: str
    #: maps a log whose poses and depth do not fit each other
    anyway: bool = False
    #: processors for its processes, () for all
    cores: tuple[int, ...] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class LogOutcome:
    """Outcome of a log; `reason` says why there is no finished map, or what of the log is damaged."""

    name: str
    state: State
    reason: str = ""
    digest: str | None = None
    processor: str = ""
    keyframes: int = 0
    objects: int = 0
    #: of the last attempt, as `cpu_s`
    wall_s: float = 0.0
    cpu_s: float = 0.0
    map_mb: float = 0.0
    #: it continued an existing map
    resumed: bool = False
    #: machine and process
    worker: str = ""


def names_of(uris: Sequence[str]) -> tuple[str, ...]:
    """Return a distinct name for each log: its file name, with a number if repeated."""
    names: list[str] = []
    for uri in uris:
        stem = _NOT_IN_NAMES.sub("-", Path(uri).resolve().stem).strip("-.") or "log"
        name, number = stem, 1
        while name in names:
            number += 1
            name = f"{stem}-{number}"
        names.append(name)
    return tuple(names)


@cache
def software() -> str:
    """Return the versions that a map depends on: this code, Python, and the libraries."""
    root = Path(__file__).resolve().parents[2]
    digest = hashlib.sha256()
    for package in _PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    libraries = " ".join(f"{name} {_version(name)}" for name in _LIBRARIES)
    python = ".".join(map(str, sys.version_info[:2]))
    return f"hickory-stream {__version__} ({digest.hexdigest()[:12]}), Python {python}, {libraries}"


def _version(library: str) -> str:
    try:
        return version(library)
    except PackageNotFoundError:
        return "none"
