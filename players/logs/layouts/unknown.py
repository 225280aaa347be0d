"""Answer to a path that is no log: what is there by kind, and what the nearest layouts of folders lack."""

from itertools import islice
from pathlib import Path

from hickory_stream.errors import UnknownLogError
from players.logs.layouts.table import LAYOUTS, has_files, layout_of

_MOST_FILES, _MOST_FOLDERS, _KINDS, _NEAREST = 100_000, 100, 6, 3
_LOGS = "metadata.yaml|*.mcap|*.bag|*.db3|*.zstd"
_HINTS = {
    **dict.fromkeys((".jpg", ".jpeg", ".png", ".txt", ".json"), "one file of a recording; name its folder"),
    **dict.fromkeys((".mp4", ".mov", ".avi", ".mkv"), "a video, which has neither depth nor poses"),
    **dict.fromkeys((".ply", ".pcd", ".obj", ".glb", ".las", ".e57"), "a mesh or cloud, which has no images"),
    **dict.fromkeys((".svo", ".svo2"), "a recording of a ZED; with its SDK: hickory-stream live zed:FILE"),
    **dict.fromkeys((".gz", ".tgz", ".tar", ".7z", ".xz"), "an archive; unpack it and name the folder"),
}


def unknown_file(file: Path, magic: bytes, expected: str) -> UnknownLogError:
    """Return the refusal of a file of no known kind."""
    hint = _HINTS.get(file.suffix.lower())
    kind = f"is {hint}" if hint else f"is of no known kind (it begins with {magic[:8].hex(' ')})"
    return UnknownLogError(f"{file} {kind}; expected {expected}")


def unknown_folder(folder: Path, expected: str) -> UnknownLogError:
    """Return the refusal of a folder of no known layout, with a line for each of the nearest ones."""
    kinds: dict[str, list[Path]] = {}
    for file in islice((file for file in folder.rglob("*") if file.is_file()), _MOST_FILES):
        kinds.setdefault(file.suffix.lower() or "without an ending", []).append(file.relative_to(folder))
    most = sorted(kinds, key=lambda kind: (-len(kinds[kind]), kind))
    found = [f"{len(kinds[kind])} {kind} (such as {min(kinds[kind])})" for kind in most[:_KINDS]]
    found += [f"{len(most) - _KINDS} more kinds"] if len(most) > _KINDS else []
    there = ", ".join(found) or "nothing"
    return UnknownLogError(f"{folder} is no log that is known: found {there}; expected {expected}", _nearest(folder))


def _nearest(folder: Path) -> tuple[str, ...]:
    lines = []
    for child in islice((child for child in sorted(folder.iterdir()) if child.is_dir()), _MOST_FOLDERS):
        layout = layout_of(child)
        if layout is not None or has_files(child, _LOGS):
            lines.append(f"{child} is {f'of the layout {layout.name}' if layout else 'a bag or holds logs'}: name it")
    scored = []
    for i, layout in enumerate(LAYOUTS):
        found, missing = layout.found(folder), layout.missing(folder)
        if found and missing:
            there = ", ".join(next(part for part in one.split("|") if has_files(folder, part)) for one in found)
            lacking = ", ".join(dict.fromkeys(one.partition("|")[0] for one in missing))
            scored.append((len(missing) / len(found), i, f"{layout.name}: found {there}; missing {lacking}"))
    return tuple([*lines, *(line for _, _, line in sorted(scored))][:_NEAREST])
