"""The manifest of a map folder, and recognition of such folders."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hickory_stream import __version__
from hickory_stream.base.confined import OutsideError, read_within
from hickory_stream.base.json_text import dumps
from hickory_stream.errors import MapFolderError

FORMAT_VERSION = 4
_READ = (3, FORMAT_VERSION)
MANIFEST = "manifest.json"
_KIND = "hickory-stream map"
_ENTRIES: dict[str, Any] = {
    "config": dict,
    "source": dict,
    "software_version": str,
    "finished_cleanly": bool,
    "digest": (str, type(None)),
    **{"run": dict, "is_reproducible": bool, "extractor": str, "processor": str, "seal": str},
}


@dataclass(frozen=True, kw_only=True, slots=True)
class Manifest:
    """Origin and state of a map."""

    config: Mapping[str, Any]
    source: Mapping[str, Any]
    #: `mode` ("playback" or "live"), `loops`, and `source`: a note of the caller to open the source again.
    run: Mapping[str, Any] = field(default_factory=dict)
    #: Log and configuration alone decided the map, on processors of the kind `processor` ("": all).
    is_reproducible: bool = True
    software_version: str = __version__
    finished_cleanly: bool = False
    #: None until the run has finished.
    digest: str | None = None
    #: Maker of the features, "" if unknown.
    extractor: str = ""
    processor: str = ""
    #: Ties the digest to `objects.json` (`digest.seal_of`).
    seal: str = ""


def manifest_json(manifest: Manifest) -> bytes:
    """Return the content of `manifest.json`."""
    first = ("software_version", "finished_cleanly", "is_reproducible", "processor", "digest", "seal", "extractor")
    entries = {name: getattr(manifest, name) for name in (*first, "run", "source", "config")}
    return pretty_json({"kind": _KIND, "format": FORMAT_VERSION, **entries})


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest of a map folder. Raises `MapFolderError`: there is no map, or it has another format."""
    if not folder.exists():
        raise MapFolderError(f"there is no map folder {folder}; `hickory-stream play LOG --out {folder}` makes one")
    if not (folder / MANIFEST).is_file():
        raise MapFolderError(f"{folder} is no map folder: it holds no {MANIFEST}; name a folder that `play` wrote")
    entry = read_json(folder, MANIFEST)
    if entry.get("kind") != _KIND:
        raise MapFolderError(f"{folder} is no map folder: its {MANIFEST} is another program's; name one of `play`'s")
    _check_format(folder, entry.get("format"))
    for name, kind in _ENTRIES.items():
        if name not in entry:
            raise MapFolderError(f"{folder / MANIFEST} is damaged: it has no {name!r}; play the log again")
        if not isinstance(entry[name], kind):
            raise MapFolderError(
                f"{folder / MANIFEST} is damaged: its {name!r} is of {type(entry[name]).__name__}; play the log again"
            )
    return Manifest(**{name: entry[name] for name in _ENTRIES})


def is_map_folder(folder: Path) -> bool:
    """Return whether a folder is a map folder of any format."""
    try:
        return read_json(folder, MANIFEST).get("kind") == _KIND
    except MapFolderError:
        return False


def read_json(folder: Path, name: str) -> dict[str, Any]:
    """Return the JSON object of a file of a map folder.

    Raises `MapFolderError`: it is missing or holds something else.
    """
    return json_of(folder, name, read_file(folder, name))


def json_of(folder: Path, name: str, content: bytes) -> dict[str, Any]:
    """Return the JSON object of the content of a file of a map folder.

    Raises `MapFolderError`: it is something else.
    """
    try:
        entry = json.loads(content)
    except (ValueError, RecursionError) as error:
        raise MapFolderError(f"{folder / name} is damaged: {error}; play the log again") from error
    if not isinstance(entry, dict):
        raise MapFolderError(f"{folder / name} is damaged: it holds no JSON object; play the log again")
    return entry


def read_file(folder: Path, name: str) -> bytes:
    """Return the content of a file of a map folder. Raises `MapFolderError`: it cannot be read, or lies elsewhere."""
    try:
        return read_within(folder, name)
    except OSError as error:
        raise MapFolderError(f"cannot read {folder / name}: {error.strerror or error}; play the log again") from error
    except OutsideError as error:
        raise MapFolderError(f"{error}; a map lies in its folder, play the log again") from error


def pretty_json(data: Any) -> bytes:
    """Return JSON for people to read."""
    return (dumps(data, indent=1) + "\n").encode()


def _check_format(folder: Path, found: object) -> None:
    if type(found) is int and found in _READ:
        return
    is_newer = isinstance(found, int) and found > FORMAT_VERSION
    remedy = "open it with a newer hickory-stream" if is_newer else "play the log again"
    raise MapFolderError(f"{folder} has map format {found}, this version reads {FORMAT_VERSION}; {remedy}")
