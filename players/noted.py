"""How a source was opened, noted down so that it can be opened in the same way again."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.testing import FaultySource, parse_faults
from players.first_frames import FirstFrames
from players.opening import open_source
from players.options import SourceOptions
from players.playback import PlaybackClock, PlayedSource

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from hickory_stream.mapping.keyframes import KeyframeConfig
    from hickory_stream.ports import Source


def note_of(
    uris: Sequence[str | Path],
    options: SourceOptions,
    *,
    first_frames: int | None = None,
    start_s: float = 0.0,
    end_s: float | None = None,
    faults: str | None = None,
    fault_seed: int = 0,
) -> dict[str, Any]:
    """Return what `open_noted` needs, made of what JSON knows; relative paths become absolute ones."""
    said = asdict(options)
    if options.pose_file is not None:
        said["pose_file"] = str(options.pose_file.absolute())
    if options.profile is not None and Path(options.profile).is_file():
        said["profile"] = str(Path(options.profile).absolute())
    return {
        "uris": [str(Path(uri).absolute()) for uri in uris],
        "options": said,
        "first_frames": first_frames,
        "start_s": start_s,
        "end_s": end_s,
        "faults": faults,
        "fault_seed": fault_seed,
    }


def open_noted(
    note: Mapping[str, Any], clock: PlaybackClock | None = None, keyframes: KeyframeConfig | None = None
) -> Source:
    """Return the source that was noted, following a clock (None: as fast as can be) that steps by `keyframes`.

    Raises:
        RecordingError: nothing is there, it is of no known kind, or lacks what mapping needs.
        CalibrationError: intrinsics or extrinsics are missing or contradict the images.
        InputError: the faults cannot be, or the log is over before the start.
    """
    known = {field.name for field in fields(SourceOptions)}
    options = {name: value for name, value in note.get("options", {}).items() if name in known}
    if options.get("pose_file") is not None:
        options["pose_file"] = Path(options["pose_file"])
    source: Source = open_source(note["uris"], SourceOptions(**options))
    if note.get("start_s", 0.0) > 0:
        # Most logs do not say where they end. Reading on to the start is cheap beside mapping, and a start beyond the
        # end is refused before a map is begun.
        next(PlayedSource(source, PlaybackClock(), start_s=note["start_s"]).frames(), None)
    if note.get("faults") is not None:
        source = FaultySource(source, parse_faults(note["faults"]), note.get("fault_seed", 0))
    start_s, end_s = note.get("start_s", 0.0), note.get("end_s")
    source = PlayedSource(source, clock or PlaybackClock(), start_s=start_s, end_s=end_s, keyframes=keyframes)
    first_frames = note.get("first_frames")
    return source if first_frames is None else FirstFrames(source, first_frames)
