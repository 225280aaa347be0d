"""Small sound logs of every container, with the same messages: a few hundred, of several sizes, in many chunks."""

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from tools.worlds.ros_messages import RosMessages

START_NS = 1_700_000_000_000_000_000
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def write_small_logs(folder: Path, num_frames: int = 40) -> dict[str, Path]:
    logs = {}
    for compression in ("none", "lz4", "zstd"):
        logs[f"mcap_{compression}"] = write_mcap(
            folder / f"{compression}.mcap", messages(RosMessages(2), num_frames), compression, 16_384
        )
    for compression in ("none", "lz4", "bz2"):
        logs[f"bag_{compression}"] = write_bag(folder / f"{compression}.bag", num_frames, compression, 16_384)
    logs["sqlite3"] = write_sqlite(folder / "small.db3", messages(RosMessages(2), num_frames))
    return logs


def messages(m: RosMessages, num_frames: int, size: tuple[int, int] = (80, 60)) -> Iterator[tuple[str, int, Any]]:
    """Yield (topic, stamp, message): a camera that walks past noise, with odometry, in the order of time."""
    width, height = size
    camera = Camera(width=width, height=height, fx=width, fy=width, cx=width / 2, cy=height / 2)
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (height, width + 64, 3), dtype=np.uint8)
    links = (("base", "cam", from_rotation_translation(OPTICAL, np.array([0.1, 0.0, 0.5]))),)
    yield "/tf_static", START_NS, m.tf(START_NS, *links)
    for i in range(num_frames):
        stamp_ns = START_NS + i * 100_000_000
        for j in range(4):
            odometry_ns = stamp_ns + j * 25_000_000
            seconds = (odometry_ns - START_NS) / 1e9
            pose = from_rotation_translation(yaw_rotation(0.1 * seconds), np.array([0.3 * seconds, 0.0, 0.0]))
            yield "/odom", odometry_ns, m.odometry(odometry_ns, "odom", "base", pose)
        shift = i % 64
        yield "/cam/color/image_rect", stamp_ns, m.image(stamp_ns, "cam", "rgb8", noise[:, shift : shift + width])
        depth = (noise[:, shift : shift + width, 0].astype(np.uint16) * 8) + 500
        yield "/cam/depth/image_rect", stamp_ns, m.image(stamp_ns, "cam", "16UC1", depth)
        for kind in ("color", "depth"):
            info = m.camera_info(stamp_ns, "cam", camera, "plumb_bob", 5)
            yield f"/cam/{kind}/camera_info", stamp_ns, info


def write_mcap(path: Path, log: Iterator[tuple[str, int, Any]], compression: str, chunk_bytes: int) -> Path:
    from mcap.writer import CompressionType, Writer

    m = RosMessages(2)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_bytes, compression=CompressionType[compression.upper()])
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for topic, stamp_ns, message in log:
            kind = message.__msgtype__
            if topic not in channels:
                definition = m.store.generate_msgdef(kind, ros_version=2)[0]
                schema = writer.register_schema(kind, "ros2msg", definition.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], stamp_ns, m.data(message), stamp_ns)
        writer.finish()
    return path


def write_bag(
    path: Path, num_frames: int, compression: str, chunk_bytes: int, size: tuple[int, int] = (80, 60)
) -> Path:
    from rosbags.rosbag1 import Writer

    m = RosMessages(1)
    writer = Writer(path)
    writer.chunk_threshold = chunk_bytes
    if compression != "none":
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    with writer:
        connections: dict[str, Any] = {}
        for topic, stamp_ns, message in messages(m, num_frames, size):
            kind = message.__msgtype__
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=m.store)
            writer.write(connections[topic], stamp_ns, m.data(message))
    return path


def write_sqlite(path: Path, log: Iterator[tuple[str, int, Any]]) -> Path:
    """Write the database of a ROS 2 bag, as Humble does."""
    m = RosMessages(2)
    database = sqlite3.connect(path)
    database.executescript(
        "CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);"
        "CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);"
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
        " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,"
        " data BLOB NOT NULL); CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
    )
    topics: dict[str, int] = {}
    for topic, stamp_ns, message in log:
        if topic not in topics:
            topics[topic] = len(topics) + 1
            row = (topics[topic], topic, message.__msgtype__, "cdr", "")
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?)", row)
        row = (topics[topic], stamp_ns, m.data(message))
        database.execute("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    database.commit()
    database.close()
    return path
