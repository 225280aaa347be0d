"""Occupancy grid for a robot's own planner, updated while the map is made.

Messages are what Nav2's static layer subscribes to: nav_msgs/OccupancyGrid on `/map`, then
map_msgs/OccupancyGridUpdate on `/map_updates`. They go into an MCAP file of ROS 2 messages and to any callable.
"""

import errno
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, BinaryIO, cast

from hickory_stream.errors import InputError, OutputError
from hickory_stream.navigation.costmap import Costmap, CostmapUpdate
from hickory_stream.navigation.robot import Robot
from hickory_stream.navigation.stand_ins import SeenSurface
from hickory_stream.records import FrameReport
from hickory_stream.sinks.ros_messages import GRID, UPDATE, definition_of, grid_message

logger = logging.getLogger(__name__)

MAP_TOPIC, UPDATES_TOPIC = "/map", "/map_updates"
_CELL_M = 0.05


class CostmapSink:
    """Sends changes of the grid to `publish` and to a file, which may be a named pipe; raises `InputError` on opening.

    A new reader of the pipe gets a whole grid first. `early`: unconfirmed objects of a live run are obstacles too.
    `show` and `close` raise `OutputError` on a disk error.
    """

    def __init__(
        self,
        robot: Robot,
        *,
        path: Path | None = None,
        publish: Callable[[CostmapUpdate], None] | None = None,
        early: bool = False,
    ) -> None:
        self._robot, self._path = robot, path
        self._seen = SeenSurface() if early else None
        self._costmap = Costmap(robot, cell_m=_CELL_M, seen=self._seen)
        self._publish = publish
        self._pipe = path if path is not None and path.is_fifo() else None
        self._file = _Messages(_opened(path)) if path is not None and self._pipe is None else None
        if self._pipe is not None:
            self._connect(self._pipe)
            if self._file is None:
                logger.warning("the costmap waits for a reader of the pipe %s; mapping continues", path)

    def show(self, report: FrameReport) -> None:
        """Send the changes of the report's snapshot."""
        if report.snapshot is None:
            return
        if self._seen is not None and report.space is not None:
            self._seen.add(report.space, report.snapshot)
        if self._pipe is not None and self._file is None:
            self._connect(self._pipe)
        if self._file is None and self._publish is None:
            return  # a new reader gets a whole grid
        update = self._costmap.update(report.snapshot)
        if update is None:
            return
        if self._publish is not None:
            self._publish(update)
        if self._file is not None:
            self._write(self._file, update)

    def close(self) -> None:
        """Finish the file; raises `OutputError` on a disk error, once."""
        file, self._file = self._file, None
        if file is not None:
            try:
                with suppress(BrokenPipeError):
                    file.close()
            except OSError as error:
                raise self._cut_off(error) from error

    def _cut_off(self, error: OSError) -> OutputError:
        cause = error.strerror or type(error).__name__
        return OutputError(f"the costmap {self._path} ends before the map does ({cause}); free space, and play again")

    def _connect(self, pipe: Path) -> None:
        stream = _opened_pipe(pipe)
        if stream is not None:
            self._file = _Messages(stream)
            # A new reader has received nothing yet: the next update is a whole grid.
            self._costmap = Costmap(self._robot, cell_m=_CELL_M, seen=self._seen)

    def _write(self, file: "_Messages", update: CostmapUpdate) -> None:
        try:
            file.write(update)
        except BrokenPipeError:
            if self._pipe is None:
                raise
            logger.warning("the reader of the pipe %s is gone; the costmap waits for another one", self._pipe)
            with suppress(BrokenPipeError):
                file.abandon()
            self._file = None
        except OSError as error:
            self._file = None
            with suppress(OSError):
                file.abandon()
            raise self._cut_off(error) from error


def _opened(path: Path) -> BinaryIO:
    try:
        return path.open("wb")
    except OSError as error:
        raise InputError(f"cannot write the costmap {path}: {error.strerror}") from error


def _opened_pipe(path: Path) -> BinaryIO | None:
    # Returns None without a reader: a blocking open would wait for one.
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_NONBLOCK)
    except OSError as error:
        if error.errno == errno.ENXIO:
            return None
        raise InputError(f"cannot write the costmap {path}: {error.strerror}") from error
    os.set_blocking(descriptor, True)
    return os.fdopen(descriptor, "wb")


class _Counted:
    # Stream that counts its bytes: the MCAP writer asks for the position, and a pipe has none.
    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self._written = 0
        self.flush, self.close = stream.flush, stream.close

    def write(self, data: bytes) -> int:
        self._written += len(data)
        return self._stream.write(data)

    def tell(self) -> int:
        return self._written


class _Messages:
    # MCAP file that is flushed after every message, so that a reader can follow it.
    def __init__(self, stream: BinaryIO) -> None:
        from mcap.writer import CompressionType, Writer

        self._stream = _Counted(stream)
        self._writer = Writer(cast("IO[bytes]", self._stream), use_chunking=False, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library="hickory_stream")
        self._channels = {topic: self._channel(topic, name) for topic, name in _TOPICS}

    def write(self, update: CostmapUpdate) -> None:
        topic, _ = _TOPICS[0] if update.is_whole else _TOPICS[1]
        _, data = grid_message(update)
        self._writer.add_message(self._channels[topic], update.stamp_ns, data, update.stamp_ns)
        self._stream.flush()

    def close(self) -> None:
        self._writer.finish()
        self._stream.close()

    def abandon(self) -> None:
        self._stream.close()

    def _channel(self, topic: str, name: str) -> int:
        schema = self._writer.register_schema(name, "ros2msg", definition_of(name).encode())
        return int(self._writer.register_channel(topic, "cdr", schema))


_TOPICS = ((MAP_TOPIC, GRID), (UPDATES_TOPIC, UPDATE))
