"""ROS 2 bags as folders: sqlite3 or MCAP, whole or split, compressed by file or message.

`metadata.yaml` gives the order of the files only; without a valid one, files are read by name.
"""

import re
import tempfile
from pathlib import Path
from typing import Any

from hickory_stream.errors import RecordingError
from players.logs.containers import Log
from players.logs.joined_log import JoinedLog

METADATA = "metadata.yaml"
SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")
_MAX_FILE_BYTES = 1 << 37


def open_ros2_bag(folder: Path) -> Log:
    """Return the log of a ROS 2 bag folder.

    Raises `RecordingError`: it holds no files of a bag, or none of them can be read.
    """
    files = bag_files(folder)
    beside: list[Path] = []
    if (folder / METADATA).is_file() and (listed := _listed(folder / METADATA)):
        files, beside = _without_strangers(files, listed)
    if not files:
        raise RecordingError(f"{folder} has a {METADATA} and no file of a bag ({', '.join(SUFFIXES)}) beside it")
    logs, errors = [], []
    for file in files:
        try:
            logs.append(open_bag_file(file))
        except RecordingError as error:
            errors.append(error)
    if not logs:
        raise RecordingError(f"{folder}: none of its {len(files)} files can be read: {errors[0]}") from errors[0]
    kinds = sorted({"MCAP" if log.kind == "MCAP" else "sqlite3" for log in logs})
    joined = JoinedLog(folder, f"ROS 2 bag ({', '.join(kinds)})", logs)
    joined.files = tuple(sorted(file for file in folder.iterdir() if file.is_file()))
    joined.unreadable = tuple(str(error) for error in errors)
    joined.notes = tuple(f"{file.name} is not in {METADATA} and was left out; name it to play it" for file in beside)
    return joined


def bag_files(folder: Path) -> list[Path]:
    """Return the files of a bag in order."""
    present = [file for file in folder.iterdir() if file.is_file() and file.name.endswith(SUFFIXES)]
    metadata = folder / METADATA
    listed = _listed(metadata) if metadata.is_file() else []
    named = [folder / name for name in listed if (folder / name).is_file()]

    def natural(file: Path) -> list[Any]:  # bag_10 comes after bag_9
        return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", file.name)]

    # A recorder that was killed does not list all files.
    return named + sorted((file for file in present if file not in named), key=natural)


def _without_strangers(files: list[Path], listed: list[str]) -> tuple[list[Path], list[Path]]:
    # A recorder that was killed has not listed its last file, whose name differs from the others in its number.
    stems = {_stem(name) for name in listed}
    own = [file for file in files if file.name in listed or _stem(file.name) in stems]
    return (own, [file for file in files if file not in own]) if own else (files, [])


def _stem(name: str) -> str:
    return re.sub(r"_\d+(\.|$)", r"\1", name).removesuffix(".zstd")


def open_bag_file(file: Path) -> Log:
    """Return the log of one file of a ROS 2 bag; one that is compressed as a whole is unpacked to a temporary file."""
    from players.logs.mcap_log import McapLog
    from players.logs.mcap_records import MAGIC
    from players.logs.sqlite_log import SqliteLog

    path = _unpacked_file(file) if file.name.endswith(".zstd") else file
    with path.open("rb") as stream:
        head = stream.read(16)
    if not head:
        raise RecordingError(f"{file} is empty")
    return McapLog(path) if head.startswith(MAGIC[:5]) else SqliteLog(path)


def _listed(metadata: Path) -> list[str]:
    text = metadata.read_text(encoding="utf-8", errors="replace")
    block = re.search(r"relative_file_paths:\s*\n((?:\s*-\s*\S.*\n?)+)", text)
    names = re.findall(r"-\s*[\"']?([^\"'\n]+?)[\"']?\s*(?:\n|$)", block.group(1)) if block is not None else []
    return [Path(name).name for name in names]


def _unpacked_file(file: Path) -> Path:
    import atexit
    import shutil

    import zstandard

    target = Path(tempfile.mkdtemp(prefix="hickory-bag-")) / file.name.removesuffix(".zstd")
    atexit.register(shutil.rmtree, target.parent, ignore_errors=True)
    try:
        with file.open("rb") as packed, target.open("wb") as unpacked:
            for block in zstandard.ZstdDecompressor().read_to_iter(packed):
                if unpacked.tell() + len(block) > min(_MAX_FILE_BYTES, shutil.disk_usage(target.parent).free):
                    raise RecordingError(f"{file} unpacks to more than there is room for on {target.parent}")
                unpacked.write(block)
    except zstandard.ZstdError as error:
        # The part before the damage is read like a truncated file.
        if target.stat().st_size == 0:
            raise RecordingError(f"{file} cannot be unpacked: {error}") from error
    return target
