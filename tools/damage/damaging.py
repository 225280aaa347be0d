"""Seeded damage to logs, as disks, networks and killed recorders cause it."""
# For tests and `tools/bench damage`: `damaged(...)` returns the bytes that it changed, so that the messages that must
# still be readable follow from the sound log rather than from the reader under test.

import mmap
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from players.logs.mcap_log import McapLog
from players.logs.ros1_log import Ros1Log
from players.logs.sqlite_log import SqliteLog
from players.logs.sqlite_pages import PageFile

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
