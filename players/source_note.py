"""Record of how a source was opened, to open it again in the same way.

The record is in the map folder, which may be untrusted: its paths are only read, and only if they are local files.
The identity of the log is compared before it is mapped.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

from hickory_stream.errors import RecordingError
from hickory_stream.mapping.rules.keyframes import KeyframeConfig
from hickory_stream.ports import Source
from players.first_frames import FirstFrames
from players.opening import open_source
from players.options import SourceOptions
from players.playback import PlaybackClock, PlayedSource

_KINDS: dict[str, Any] = {
    **{"uris": list, "options": dict, "first_frames": int},
    **{"start_s": (int, float), "end_s": (int, float)},
}


def make_source_note(
    uris: Sequence[str | Path],
    options: SourceOptions,
    *,
    first_frames: int | None = None,
    start_s: float = 0.0,
    end_s: float | None = None,
) -> dict[str, Any]:
    """Return the arguments of `open_from_note` as JSON values; relative paths become absolute ones."""
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
    }


def open_from_note(
    note: Mapping[str, Any], clock: PlaybackClock | None = None, keyframes: KeyframeConfig | None = None
) -> Source:
    """Return the noted source, following a clock (None: as fast as possible) that steps by `keyframes`.

    Raises as `open_source`; `RecordingError`: the note is damaged, or of a run with faults; `InputError`: the log ends
    before the start.
    """
    _check(note)
    known = {field.name for field in fields(SourceOptions)}
    options = {name: value for name, value in note.get("options", {}).items() if name in known}
    if options.get("pose_file") is not None:
        options["pose_file"] = Path(options["pose_file"])
    source: Source = open_source(note["uris"], SourceOptions(**options))
    if note.get("start_s", 0.0) > 0:
        # Most logs do not declare their end. Reading up to the start is cheap compared with mapping, and a start beyond
        # the end is refused before a map is begun.
        next(PlayedSource(source, PlaybackClock(), start_s=note["start_s"]).frames(), None)
    start_s, end_s = note.get("start_s", 0.0), note.get("end_s")
    source = PlayedSource(source, clock or PlaybackClock(), start_s=start_s, end_s=end_s, keyframes=keyframes)
    first_frames = note.get("first_frames")
    return source if first_frames is None else FirstFrames(source, first_frames)


def _check(note: Mapping[str, Any]) -> None:
    for name, kinds in _KINDS.items():
        value = note.get(name)
        is_missing = value is None and name != "uris"
        if not is_missing and (not isinstance(value, kinds) or isinstance(value, bool)):
            raise RecordingError(f"found {name} {value!r:.60} in the note of how the log was opened; play it again")
    if note.get("faults") is not None:
        raise RecordingError(
            f"found faults ({note['faults']!r:.60}) in the note of how the log was opened: they are no longer put into "
            "a source; play it again"
        )
    options = note.get("options") or {}
    for name, value in options.items():
        kind = int if name.endswith("_ns") else str
        if value is not None and (not isinstance(value, kind) or isinstance(value, bool)):
            raise RecordingError(f"found the option {name} {value!r:.60} in the note of how the log was opened")
    for path in [*note["uris"], options.get("pose_file"), options.get("profile")]:
        if path is not None:
            _check_path(path)


def _check_path(path: object) -> None:
    if not isinstance(path, str) or not path or "\0" in path or path.startswith(("//", "\\\\")):
        raise RecordingError(f"found the path {path!r:.60}, expected one of this machine; name the log itself")
    # A name that is no file is the name of a profile, or of a missing log; both are checked later.
    if Path(path).exists() and not (Path(path).is_file() or Path(path).is_dir()):
        raise RecordingError(f"{path} is neither a file nor a folder; name the log itself")
