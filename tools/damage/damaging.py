"""Seeded damage to logs, as disks, networks and killed recorders cause it."""
# `damaged(...)` returns the bytes that it changed: the messages that must stay readable follow from the sound log.
# Sound logs of all containers hold the same messages.

import mmap
import struct
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation
from players.logs.mcap_log import McapLog
from players.logs.ros1_log import Ros1Log
from players.logs.sqlite_log import SqliteLog
from players.logs.sqlite_pages import PageFile
from tools.worlds.ros_bags import HumbleDatabase, Ros1Bag, RosMessages

Kind = Literal["cut", "cut_at_boundary", "flip", "zero", "no_footer", "no_index", "shuffle", "huge_length"]
KINDS = get_args(Kind)

Span = tuple[int, int]
# Lengths that a reader must reject.
_LENGTHS = [1 << 62, 1 << 40, (1 << 32) - 1, (1 << 31) - 1]


@dataclass(frozen=True, kw_only=True, slots=True)
class Part:
    """The smallest piece of a log that can be lost: the bytes it needs, and the messages in it, (topic, data)."""

    spans: tuple[Span, ...]
    messages: tuple[tuple[str, bytes], ...]


def parts_of(log: McapLog | Ros1Log | SqliteLog) -> list[Part]:
    """Return the pieces of a sound log: the chunks of MCAP and ROS 1, the rows of a database."""
    if isinstance(log, SqliteLog):
        return _rows_of(log)
    names = [topic.name for topic in log.topics]
    everything = [(message.topic, bytes(message.data)) for message in log.messages(names)]
    parts, at = [], 0
    for span, number in _chunks_of(log):
        parts.append(Part(spans=(span,), messages=tuple(everything[at : at + number])))
        at += number
    assert at == len(everything), "every message lies in a chunk"
    return parts


def damaged(data: bytes, parts: list[Part], kind: Kind, rng: np.random.Generator) -> tuple[bytes, list[Span]]:
    """Return a damaged copy of a file, and the spans of the original that it changed."""
    size = len(data)
    spans = sorted(span for part in parts for span in part.spans)
    match kind:
        case "cut":
            at = int(rng.integers(20, size))
            return data[:at], [(at, size)]
        case "cut_at_boundary":
            start, end = spans[int(rng.integers(len(spans)))]
            at = max(20, int(rng.choice([start, end])) + int(rng.integers(-2, 3)))
            return data[:at], [(at, size)]
        case "flip":
            places = rng.integers(0, size, int(rng.integers(1, 9)))
            return _with(data, {int(p): bytes([data[p] ^ int(rng.integers(1, 256))]) for p in places})
        case "zero":
            at = int(rng.integers(0, size))
            return _with(data, {at: bytes(min(size - at, int(rng.integers(1, 8192))))})
        case "no_footer":
            at = size - int(rng.integers(1, 64))
            return data[:at], [(at, size)]
        case "no_index":
            at = spans[-1][1]
            return data[:at], [(at, size)]
        case "shuffle":
            return _shuffled(data, spans, rng), []
        case "huge_length":
            start, _ = spans[int(rng.integers(len(spans)))]
            claim = int(rng.choice(_LENGTHS))
            if data.startswith(b"\x89MCAP"):
                return _with(data, {start + 1: struct.pack("<Q", claim)})
            return _with(data, {start: struct.pack("<I", claim & 0xFFFFFFFF)})


def survivors(parts: list[Part], touched: list[Span]) -> list[tuple[str, bytes]]:
    """Return the messages of all pieces outside the damage."""
    return [
        message
        for part in parts
        if not any(a < end and start < b for a, b in part.spans for start, end in touched)
        for message in part.messages
    ]


def _with(data: bytes, patches: dict[int, bytes]) -> tuple[bytes, list[Span]]:
    copy = bytearray(data)
    for at, patch in patches.items():
        copy[at : at + len(patch)] = patch[: len(data) - at]
    return bytes(copy), [(at, at + len(patch)) for at, patch in patches.items()]


def _shuffled(data: bytes, spans: list[Span], rng: np.random.Generator) -> bytes:
    starts = [start for start, _ in spans]
    ends = [*starts[1:], spans[-1][1]]
    blocks = [data[start:end] for start, end in zip(starts, ends, strict=True)]
    order = rng.permutation(len(blocks))
    return data[: starts[0]] + b"".join(blocks[i] for i in order) + data[ends[-1] :]


def _chunks_of(log: McapLog | Ros1Log) -> list[tuple[Span, int]]:
    with log.path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        return log.chunk_spans(data)


def _rows_of(log: SqliteLog) -> list[Part]:
    pages = PageFile(log.path)
    names = {number: row[0] for number, row in log.topic_rows.items()}
    parts = []
    for row in pages.rows("messages"):
        values = row.values()
        assert values is not None
        assert isinstance(values[3], bytes)
        parts.append(Part(spans=tuple(pages.spans(row)), messages=((names[values[1]], values[3]),)))
    return parts


def open_sound(path: Path) -> McapLog | Ros1Log | SqliteLog:
    return McapLog(path) if path.suffix == ".mcap" else Ros1Log(path) if path.suffix == ".bag" else SqliteLog(path)


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


def write_mcap(path: Path, log: Iterable[tuple[str, int, Any]], compression: str, chunk_bytes: int) -> Path:
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
    bag = Ros1Bag(path, compression, chunk_bytes)
    for topic, stamp_ns, message in messages(bag.messages, num_frames, size):
        bag.put(topic, stamp_ns, message)
    bag.close()
    return path


def write_sqlite(path: Path, log: Iterator[tuple[str, int, Any]]) -> Path:
    """Write the database of a ROS 2 bag."""
    m, database = RosMessages(2), HumbleDatabase(path)
    for topic, stamp_ns, message in log:
        database.put(topic, message.__msgtype__, stamp_ns, m.data(message))
    database.close()
    return path
