"""How a source was opened, noted down so that it can be opened in the same way again."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from players.first_frames import FirstFrames
from players.opening import open_source
from players.options import SourceOptions

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hickory_stream.ports import Source


def note_of(uri: str | Path, options: SourceOptions, first_frames: int | None = None) -> dict[str, Any]:
    """Return what `open_noted` needs, made of what JSON knows; a relative path becomes an absolute one."""
    return {"uri": str(Path(uri).absolute()), "options": asdict(options), "first_frames": first_frames}


def open_noted(note: Mapping[str, Any]) -> Source:
    """Return the source that was noted.

    Raises:
        RecordingError: nothing is there, it is of no known kind, or lacks what mapping needs.
        CalibrationError: intrinsics or extrinsics are missing or contradict the images.
    """
    known = {field.name for field in fields(SourceOptions)}
    options = {name: value for name, value in note.get("options", {}).items() if name in known}
    source = open_source(note["uri"], SourceOptions(**options))
    first_frames = note.get("first_frames")
    return source if first_frames is None else FirstFrames(source, first_frames)
