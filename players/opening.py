"""Recognition of logs and folders by their first bytes or files, never by extension alone."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.errors import NoPosesError, RecordingError
from players.options import SourceOptions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hickory_stream.ports import Source
    from players.logs.containers import Log
    from players.poses.odometry_source import OdometrySource

logger = logging.getLogger(__name__)

_MCAP = b"\x89MCAP"
_ROS1 = b"#ROSBAG"
_SQLITE = b"SQLite format 3\0"
_ZSTD = b"\x28\xb5\x2f\xfd"
_KINDS = "an MCAP file, a ROS 1 or ROS 2 bag, a .sens or .r3d file, or an image folder as in players/README.md"


def open_source(uri: str | Path | Sequence[str | Path], options: SourceOptions | None = None) -> Source:
    """Return the source for a recorded log or an image folder; a list of logs is played as one log.

    Raises `RecordingError`: nothing is there, it is of no known kind, or lacks what mapping needs; `CalibrationError`:
    intrinsics or extrinsics are missing or contradict the images.
    """
    options = options or SourceOptions()
    if options.odometry == "auto":
        try:
            return _open(uri, options)
        except NoPosesError as error:
            source = open_estimating(uri, options)
            logger.info("%s", error)
            logger.warning("%s has no poses: odometry on its %s estimates them", source.info.uri, source.sensor)
            return source
    return _open(uri, options) if options.odometry == "topic" else open_estimating(uri, options)


def open_estimating(uri: str | Path | Sequence[str | Path], options: SourceOptions) -> OdometrySource:
    """Return a source that estimates its poses, by the chosen odometry ("auto": LiDAR, else depth).

    Raises `HickoryError`: as of `open_source`; or the chosen sensor or method is not available.
    """
    from players.poses.odometry_source import with_odometry

    choice = options.odometry
    return with_odometry(_open(uri, options if options.estimates_poses else replace(options, odometry="depth")), choice)


def _open(uri: str | Path | Sequence[str | Path], options: SourceOptions) -> Source:
    paths = [Path(uri)] if isinstance(uri, str | Path) else [Path(part) for part in uri]
    if len(paths) == 1:
        from players.logs.layouts.table import opener_of

        opener = opener_of(paths[0])
        if opener is not None:
            if options.robot is not None:
                found = f"found --robot {options.robot}"
                raise RecordingError(f"{found}, but a folder of images is of no robot; leave it out")
            return opener(paths[0], options)
    from players.logs.log_opening import open_log

    log = open_log(open_container(*paths), options)
    if options.extrinsics == "log":
        return log
    from players.poses.extrinsics import with_estimated_extrinsics

    return with_estimated_extrinsics(log)


def open_container(*paths: Path) -> Log:
    """Return the container of a recorded log, or of several logs as one.

    Raises `RecordingError`: nothing is there, or it is of no known kind.
    """
    if not paths:
        raise RecordingError(f"no log was named; expected {_KINDS}")
    logs = []
    for path in paths:
        try:
            logs.append(_open_bag_folder(path) if path.is_dir() else _open_file(path))
        except OSError as error:
            raise RecordingError(f"{error.filename or path} cannot be read: {error.strerror or error}") from error
    if len(logs) == 1:
        return logs[0]
    from players.logs.joined_log import JoinedLog

    kinds = list(dict.fromkeys(log.kind for log in logs))
    return JoinedLog(paths[0], f"{len(logs)} logs ({', '.join(kinds)})", logs)


def _open_file(path: Path) -> Log:
    from players.logs.layouts.unknown import unknown_file

    if not path.exists():
        raise RecordingError(f"no such file or folder: {path}")
    if not path.is_file():
        raise RecordingError(f"{path} is a pipe or a device; expected {_KINDS}")
    with path.open("rb") as stream:
        magic = stream.read(16)
    if not magic:
        raise RecordingError(f"{path} is empty; expected {_KINDS}")
    if magic.startswith(_ROS1):
        from players.logs.realsense_bag import as_viewer_bag
        from players.logs.ros1_log import Ros1Log

        return as_viewer_bag(Ros1Log(path))
    if magic.startswith((_MCAP, _SQLITE, _ZSTD)) and (magic[:4] != _ZSTD or path.suffix == ".zstd"):
        from players.logs.ros2_bag import open_bag_file

        return open_bag_file(path)
    # The first bytes may be damaged.
    suffix = path.name.removesuffix(".zstd").rsplit(".", 1)[-1]
    damaged = unknown_file(path, magic, _KINDS)
    if suffix in ("bag", "mcap", "db3"):
        try:
            return _open_by_suffix(path, suffix)
        except RecordingError as error:
            raise damaged from error
    raise damaged


def _open_by_suffix(path: Path, suffix: str) -> Log:
    from players.logs.mcap_log import McapLog
    from players.logs.ros1_log import Ros1Log
    from players.logs.sqlite_log import SqliteLog

    log: Log = Ros1Log(path) if suffix == "bag" else McapLog(path) if suffix == "mcap" else SqliteLog(path)
    if not log.topics:
        raise RecordingError(f"{path} holds no topics")
    return log


def _open_bag_folder(folder: Path) -> Log:
    from players.logs.layouts.unknown import unknown_folder
    from players.logs.ros2_bag import METADATA, bag_files, open_ros2_bag

    names = sorted(entry.name for entry in folder.iterdir())
    if METADATA in names:
        return open_ros2_bag(folder)
    logs = [name for name in names if name.endswith((".mcap", ".bag", ".db3", ".db3.zstd", ".mcap.zstd"))]
    if len(logs) == 1:
        return _open_file(folder / logs[0])
    # The names of a split recording differ in a single number.
    if len({re.sub(r"\d+(?=\D*$)", "#", name.split(".")[0]) + name[name.index(".") :] for name in logs}) == 1:
        if len(bag_files(folder)) == len(logs):
            return open_ros2_bag(folder)
        return open_container(*(folder / name for name in logs))
    if logs:
        raise RecordingError(
            f"{folder} holds {len(logs)} logs without a {METADATA}, and their names are not those of one split "
            f"recording; name the ones to play: {', '.join(logs)}"
        )
    raise unknown_folder(folder, _KINDS)
