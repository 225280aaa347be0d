"""ROS 1 bags and ROS 2 bags (sqlite3 or MCAP storage, with or without metadata.yaml), read with rosbags."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hickory_stream.errors import RecordingError
from players.containers import LogMessage, Topic, merged_topics, normalized_type

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from players.containers import DefinitionFormat


class BagLog:
    """A `Log` in a ROS 1 bag file, a ROS 2 bag folder or a ROS 2 database file."""

    def __init__(self, path: Path, *, is_ros1: bool) -> None:
        """Read the index.

        Raises:
            RecordingError: the bag is truncated, damaged, or of a kind that rosbags does not read.
        """
        self.path = path
        self.kind = "ROS 1 bag" if is_ros1 else "ROS 2 bag"
        self.files = tuple(sorted(file for file in path.iterdir() if file.is_file())) if path.is_dir() else (path,)
        self._is_ros1 = is_ros1
        try:
            with self._reader() as reader:
                self.topics = merged_topics([self._topic(connection) for connection in reader.connections])
        except _damage() as error:
            raise self._damaged(error) from error

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics in the order of their log time.

        Raises:
            RecordingError: the bag is damaged where it is read.
        """
        # A reader of its own for each pass: two passes over one file handle would move it under each other's feet.
        try:
            with self._reader() as reader:
                connections = [c for c in reader.connections if c.topic in topics]
                if not connections:
                    return
                for connection, log_ns, data in reader.messages(connections=connections):
                    yield LogMessage(connection.topic, log_ns, data)
        except _damage() as error:
            raise self._damaged(error) from error

    def _reader(self) -> Any:
        if self._is_ros1:
            from rosbags.rosbag1 import Reader as Ros1Reader

            return Ros1Reader(self.path)
        from rosbags.rosbag2 import Reader as Ros2Reader

        return Ros2Reader(self.path)

    def _topic(self, connection: Any) -> Topic:
        formats: dict[str, DefinitionFormat] = {"MSG": "msg", "IDL": "idl"}
        return Topic(
            name=connection.topic,
            type_name=normalized_type(connection.msgtype),
            num_messages=connection.msgcount,
            wire="ros1" if self._is_ros1 else "cdr",
            definition_format=formats.get(connection.msgdef.format.name, "none"),
            definition=connection.msgdef.data,
        )

    def _damaged(self, error: Exception) -> RecordingError:
        detail = str(error) or type(error).__name__
        return RecordingError(f"{self.path} cannot be read as a {self.kind}: {detail}")


def _damage() -> tuple[type[Exception], ...]:
    """Return what rosbags raises on bytes that are no bag: its own errors, and those of parsing and unpacking."""
    import sqlite3
    import struct

    from rosbags.rosbag1 import ReaderError as Ros1Error
    from rosbags.rosbag2 import ReaderError as Ros2Error
    from rosbags.typesys import TypesysError

    parsing = (struct.error, LookupError, ValueError, EOFError, RuntimeError, AssertionError)
    return (Ros1Error, Ros2Error, TypesysError, sqlite3.Error, FileNotFoundError, *parsing)
