"""The journal of a run, read step by step, whether it is complete or was cut off; `journal_format` describes it."""

from __future__ import annotations

import mmap
import os
import struct
from bisect import bisect_right
from collections import OrderedDict
from dataclasses import dataclass, replace
from io import BytesIO
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk

from hickory_stream.confined import OutsideError, open_within
from hickory_stream.engine.checkpoints import unpacked
from hickory_stream.engine.journal_format import (
    CHANNELS,
    CHECKPOINT,
    COLOR,
    EVENT_NAMES,
    JOURNAL,
    STEP,
    TOLD,
)
from hickory_stream.engine.record_codec import decode, part_references
from hickory_stream.engine.step import Checkpoint, JournalEntry, Step, StepKind
from hickory_stream.errors import MapFolderError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from hickory_stream.events import Event

_MAGIC = b"\x89MCAP0\r\n"
_CHUNK_OPCODE, _INDEX_OPCODE = 0x06, 0x07
_CACHED_CHUNKS = 64
# A chunk that claims to unpack to more is none of ours: the state of a large map takes some tens of megabytes.
_MOST_CHUNK_BYTES = 1 << 29
_DAMAGE = (
    McapError,
    zstandard.ZstdError,
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    struct.error,
    EOFError,
    OverflowError,
    MemoryError,
)


@dataclass(frozen=True, slots=True)
class _Place:
    """Where a chunk is in the file."""

    start: int
    end: int
    channel: int
    stamp_ns: int

    @property
    def is_step(self) -> bool:
        return self.channel == STEP


class Journal:
    """A journal that is read; open it with `with`. Complete or not, it holds what was whole when it was opened.

    Raises:
        MapFolderError: there is none, or it is none of this format.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL
        try:
            with open_within(folder, JOURNAL) as file:
                empty = os.fstat(file.fileno()).st_size == 0
                self._data: Any = b"" if empty else mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except FileNotFoundError as error:
            raise MapFolderError(
                f"{folder} holds no {JOURNAL}: the map keeps no history; play the log again"
            ) from error
        except OSError as error:
            raise MapFolderError(f"cannot read {self.path}: {error.strerror or error}") from error
        except OutsideError as error:
            raise MapFolderError(f"{error}; a map's journal lies in its folder") from error
        self._places = _scan(self._data, self.path)
        self._steps = [i for i, place in enumerate(self._places) if place.is_step]
        self._cache: OrderedDict[int, list[Message]] = OrderedDict()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cache.clear()
        if isinstance(self._data, mmap.mmap):
            self._data.close()

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """The stamp of every step."""
        return np.array([self._places[i].stamp_ns for i in self._steps], dtype=np.int64)

    @property
    def num_bytes(self) -> int:
        """How much of the file is whole."""
        return self._places[-1].end if self._places else 0

    def entry(self, index: int) -> JournalEntry:
        """Return a step with its events.

        Raises:
            MapFolderError: it is damaged.
        """
        others = self._messages(self._steps[index])[1:]
        events = [
            self._decoded(message.data, EVENT_NAMES[message.channel_id])
            for message in others
            if message.channel_id in EVENT_NAMES
        ]
        told = [self._decoded(message.data, "Told") for message in others if message.channel_id == TOLD]
        return JournalEntry(step=self.step(index), events=tuple(events), told=told[0] if told else None)

    def step(self, index: int) -> Step:
        """Return a step without its events."""
        step: Step = self._decoded(self._messages(self._steps[index])[0].data, "Step")
        return step

    def events(self, index: int, kind: str) -> list[Event]:
        """Return the events of one kind in a step."""
        channel = CHANNELS[kind]
        return [self._decoded(m.data, kind) for m in self._messages(self._steps[index]) if m.channel_id == channel]

    def color(self, index: int) -> bytes | None:
        """Return the compressed image of a step's keyframe, None where there is none."""
        found = [m.data for m in self._messages(self._steps[index]) if m.channel_id == COLOR]
        return found[0] if found else None

    def checkpoint_before(self, index: int) -> tuple[int, Checkpoint] | None:
        """Return the last checkpoint at or before a step, and the step after which it was made; None: there is none."""
        following = self._steps[index + 1] if index + 1 < len(self._steps) else len(self._places)
        for chunk in range(following - 1, -1, -1):
            if self._places[chunk].channel == CHECKPOINT:
                return bisect_right(self._steps, chunk) - 1, self._checkpoint(chunk)
        return None

    def entries(self, first: int = 0) -> Iterator[JournalEntry]:
        """Yield the steps from one on."""
        for index in range(first, len(self)):
            yield self.entry(index)

    def cut_to_resumable(self) -> None:
        """Leave out the steps that a run cannot be continued from: after the first damage, or committed at a stop."""
        for position, chunk in enumerate(self._steps):
            try:
                kind = self.step(position).kind
            except MapFolderError:
                kind = StepKind.CLOSING
            if kind is StepKind.CLOSING:
                self._cut(chunk)
                break
        for chunk, place in enumerate(self._places):
            if not place.is_step:
                try:
                    self._messages(chunk)
                except MapFolderError:
                    self._cut(chunk)
                    break

    def chunks(self) -> Iterator[list[Message]]:
        """Yield the messages of each chunk."""
        for chunk in range(len(self._places)):
            yield self._messages(chunk)

    def _cut(self, chunk: int) -> None:
        self._places = self._places[:chunk]
        self._steps = [i for i in self._steps if i < chunk]

    def _checkpoint(self, chunk: int) -> Checkpoint:
        parts: dict[tuple[int, int], Any] = {}

        def part(other: int, number: int) -> Any:
            place = (other, number)
            if place not in parts:
                parts[place] = decode(stored[place], part)
            return parts[place]

        try:
            stored = self._with_parts(chunk)
            checkpoint: Checkpoint = self._decoded(stored[chunk, 0], "Checkpoint", part)
            return replace(checkpoint, core=unpacked(checkpoint.core))
        except (ValueError, IndexError) as error:
            raise MapFolderError(f"{self.path} is damaged or of another version: {error}") from error

    def _with_parts(self, chunk: int) -> dict[tuple[int, int], bytes]:
        """Return the document of a checkpoint, and all parts that it or one of them refers to, as they are stored.

        The parts of a large map lie in hundreds of chunks. No part refers to a later chunk than its own: each is
        unpacked once, the latest first, and only what is needed of it is kept.

        Raises:
            ValueError: a part is said to lie where none can be.
            IndexError: a chunk has fewer parts.
            MapFolderError: a chunk is damaged.
        """
        stored: dict[tuple[int, int], bytes] = {}
        wanted = {chunk: {0}}
        while wanted:
            here = max(wanted)
            numbers = wanted.pop(here)
            messages = self._unpacked(here)
            while numbers:
                number = numbers.pop()
                stored[here, number] = messages[number].data
                for other, its_number in part_references(messages[number].data):
                    if type(other) is not int or not 0 <= other <= here:
                        raise ValueError(f"a part is said to lie in chunk {other}")
                    # The first message is the document, which no part refers to.
                    if type(its_number) is not int or its_number < 1:
                        raise ValueError(f"a part is said to be number {its_number}")
                    if (other, its_number) not in stored:
                        (numbers if other == here else wanted.setdefault(other, set())).add(its_number)
        return stored

    def _decoded(self, data: bytes, kind: str, part: Callable[[int, int], NDArray[Any]] | None = None) -> Any:
        """Return a record of this kind, by the name of its type."""
        try:
            record = decode(data, part)
        except ValueError as error:
            raise MapFolderError(f"{self.path} is damaged or of another version: {error}") from error
        if type(record).__name__ != kind:
            raise MapFolderError(
                f"{self.path} is damaged or of another version: found a {type(record).__name__}, expected a {kind}"
            )
        return record

    def _messages(self, chunk: int) -> list[Message]:
        cached = self._cache.get(chunk)
        if cached is not None:
            self._cache.move_to_end(chunk)
            return cached
        messages = self._unpacked(chunk)
        self._cache[chunk] = messages
        if len(self._cache) > _CACHED_CHUNKS:
            self._cache.popitem(last=False)
        return messages

    def _unpacked(self, chunk: int) -> list[Message]:
        place = self._places[chunk]
        try:
            record = Chunk.read(ReadDataStream(BytesIO(self._data[place.start : place.end])))
            _check_unpacked_size(record)
            messages = [m for m in breakup_chunk(record, validate_crc=True) if isinstance(m, Message)]
            if not messages:
                raise ValueError("a chunk without messages")
        except _DAMAGE as error:
            raise MapFolderError(
                f"{self.path} is damaged at byte {place.start}: {error}; play the log again"
            ) from error
        return messages


def _check_unpacked_size(chunk: Chunk) -> None:
    """Refuse a chunk that is not compressed by zstd, or declares another size than its data has or a map can need.

    Raises:
        ValueError: it is none of ours.
    """
    if chunk.compression != "zstd":
        raise ValueError(f"a chunk is packed by {chunk.compression or 'nothing'!r}, expected zstd")
    found = zstandard.frame_content_size(chunk.data)
    if found != chunk.uncompressed_size or found > _MOST_CHUNK_BYTES:
        raise ValueError(f"a chunk unpacks to {found} bytes, says {chunk.uncompressed_size}")


def _scan(data: Any, path: Path) -> list[_Place]:
    """Return the chunks that are whole: the record is there, and the index after it, which says what is in it."""
    if len(data) < len(_MAGIC):
        return []
    if data[: len(_MAGIC)] != _MAGIC:
        raise MapFolderError(f"{path} is no MCAP file; play the log again")
    places: list[_Place] = []
    at, chunk = len(_MAGIC), None
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        start, end = at + 9, at + 9 + length
        if end > len(data):
            break
        if opcode == _CHUNK_OPCODE and length >= 16:
            chunk = (start, end, struct.unpack_from("<Q", data, start)[0])
        elif opcode == _INDEX_OPCODE and chunk is not None and length >= 2:
            channel = struct.unpack_from("<H", data, start)[0]
            places.append(_Place(chunk[0], chunk[1], channel, chunk[2]))
            chunk = None
        at = end
    return places
