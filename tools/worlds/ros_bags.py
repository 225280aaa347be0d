"""Messages and bags of ROS 1 and ROS 2 for synthetic logs."""

import sqlite3
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from players.messages import ros_messages


class RosMessages(ros_messages.RosMessages):
    """Builds and serialises messages of ROS 1 or ROS 2."""

    def __init__(self, ros: Literal[1, 2]) -> None:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        super().__init__()
        self.ros = ros
        if ros == 1:
            self.camera_matrices = ("D", "K", "R", "P")
            self.more_of_header = MappingProxyType({"seq": 0})
            self.store = get_typestore(Stores.ROS1_NOETIC)
            transforms = "geometry_msgs/TransformStamped[] transforms"
            self.store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))

    def data(self, message: Any) -> bytes:
        if self.ros == 1:
            return bytes(self.store.serialize_ros1(message, message.__msgtype__))
        return super().data(message)


class Ros1Bag:
    """Writes messages into a bag of ROS 1; `compression` is none, lz4 or bz2."""

    def __init__(self, path: Path, compression: str = "lz4", chunk_bytes: int | None = None) -> None:
        from rosbags.rosbag1 import Writer

        self.messages, self._writer = RosMessages(1), Writer(path)
        if chunk_bytes is not None:
            self._writer.chunk_threshold = chunk_bytes
        if compression != "none":
            self._writer.set_compression(Writer.CompressionFormat[compression.upper()])
        self._writer.open()
        self._connections: dict[str, Any] = {}
        self.close = self._writer.close

    def put(self, topic: str, log_ns: int, message: Any, more: bytes = b"") -> None:
        """Write a message with further bytes behind it."""
        if topic not in self._connections:
            kind, store = message.__msgtype__, self.messages.store
            self._connections[topic] = self._writer.add_connection(topic, kind, typestore=store)
        self._writer.write(self._connections[topic], log_ns, self.messages.data(message) + more)


class HumbleDatabase:
    """Writes the database of a ROS 2 bag as Humble does: schema version 3, without message definitions."""

    def __init__(self, path: Path) -> None:
        self._database = sqlite3.connect(path, isolation_level=None)
        self._database.executescript(
            "PRAGMA journal_mode = MEMORY; PRAGMA synchronous = OFF;"
            "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
            "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);"
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
            " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
            " data BLOB NOT NULL);"
            "CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
            "INSERT INTO schema VALUES (3, 'humble'); BEGIN"
        )
        #: Number and type by name.
        self.topics: dict[str, tuple[int, str]] = {}

    def put(self, topic: str, kind: str, log_ns: int, data: bytes) -> None:
        if topic not in self.topics:
            self.topics[topic] = (len(self.topics) + 1, kind)
            row = (self.topics[topic][0], topic, kind, "cdr", "")
            self._database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
        row = (self.topics[topic][0], log_ns, data)
        self._database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)

    def close(self) -> tuple[dict[int, int], int, int]:
        """Return the count of messages by topic, and the first and the last stamp."""
        self._database.execute("COMMIT")
        counts = dict(self._database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
        (low, high), *_ = self._database.execute("SELECT min(timestamp), max(timestamp) FROM messages")
        self._database.close()
        return counts, low or 0, high or 0
