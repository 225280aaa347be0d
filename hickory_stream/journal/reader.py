"""The journal of a run, read step by step, complete or cut off; `format` describes it.

Chunks are unpacked on request. The file stays open as long as arrays of it are still to be read.
"""

import mmap
import os
import struct
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple, Self

import numpy as np
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import get_chunk_data_stream
from numpy.typing import NDArray

from hickory_stream.base.confined import OutsideError, open_within
from hickory_stream.errors import MapFolderError
from hickory_stream.events import Event
from hickory_stream.journal.checkpoints import unpacked
from hickory_stream.journal.format import (
    ARRAYS,
    CHANNELS,
    CHECKPOINT,
    COLOR,
    EVENT_NAMES,
    JOURNAL,
    KNOWN,
    MAGIC,
    STEP,
    TOLD,
)
from hickory_stream.journal.lazy_records import LazyRecords, as_array
from hickory_stream.journal.mcap_file import FileMessage, messages_in
from hickory_stream.journal.packed_frames import PackedFrame, unpacked_frame
from hickory_stream.journal.record_codec import PartPlace, decode, part_references
from hickory_stream.journal.snapshot_records import Known
from hickory_stream.journal.step import Checkpoint, JournalEntry, Step, StepKind, Told

_CACHED_CHUNKS, _CACHED_BYTES = 64, 64 << 20
# A chunk that claims more is damaged: the state of a large map takes some tens of megabytes.
_MOST_CHUNK_BYTES = 1 << 29
_HEADER = struct.Struct("<BQ")
_DAMAGE = (
    *(McapError, zstandard.ZstdError, struct.error, EOFError),
    *(ValueError, KeyError, IndexError, TypeError, OverflowError, MemoryError),
)


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """The place of a chunk in the file."""

    start: int
    end: int
    channel: int
    stamp_ns: int

    @property
    def is_step(self) -> bool:
        """Whether it holds a step of the run."""
        return self.channel == STEP


class JournalChunks:
    """The whole chunks of the journal in a folder when it was opened, at their `places`.

    Raises `MapFolderError`: there is no journal, or it has another format.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / JOURNAL
        try:
            with open_within(folder, JOURNAL) as file:
                empty = os.fstat(file.fileno()).st_size == 0
                self._data: Any = b"" if empty else mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except FileNotFoundError as error:
            missing = f"{folder} holds no {JOURNAL}"
            raise MapFolderError(f"{missing}: the map keeps no history; play the log again") from error
        except OSError as error:
            raise MapFolderError(f"cannot read {self.path}: {error.strerror or error}") from error
        except OutsideError as error:
            raise MapFolderError(f"{error}; a map's journal lies in its folder") from error
        self.places = _scan(self._data, self.path)
        self._cache = _Cache()
        self._lock = Lock()

    def messages(self, chunk: int, *, keeps: bool = True) -> list[FileMessage]:
        """Return the messages of a chunk; `keeps` caches them. Raises `MapFolderError`: it is damaged."""
        with self._lock:
            known = self._cache.get(chunk)
            if known is not None:
                return known
            records = self.records(chunk)
            try:
                messages = messages_in(memoryview(records))
            except _DAMAGE as error:
                raise self._damage(self.places[chunk], error) from error
            if keeps:
                self._cache.keep(chunk, messages, len(records))
            return messages

    def records(self, chunk: int) -> bytes:
        """Return the records of a chunk, joined. Raises `MapFolderError`: it is damaged."""
        place = self.places[chunk]
        try:
            stream, length = get_chunk_data_stream(self._record(place), validate_crc=True)
            return bytes(stream.read(length))
        except _DAMAGE as error:
            raise self._damage(place, error) from error

    def read_copy(self) -> None:
        """Continue in the folder's current file, which begins with the same chunks."""
        copy = JournalChunks(self.path.parent)
        with self._lock:
            self._data, self.places = copy._data, copy.places

    def _record(self, place: ChunkPlace) -> Chunk:
        chunk = Chunk.read(ReadDataStream(BytesIO(self._data[place.start : place.end])))
        if chunk.compression != "zstd":
            raise ValueError(f"a chunk is packed by {chunk.compression or 'nothing'!r}, expected zstd")
        check_unpacked_size(chunk.data, chunk.uncompressed_size)
        return chunk

    def _damage(self, place: ChunkPlace, error: BaseException) -> MapFolderError:
        return MapFolderError(f"{self.path} is damaged at byte {place.start}: {error}; play the log again")


def packed_array(encoded: bytes) -> bytes:
    """Return an encoded array for a chunk of arrays."""
    return zstandard.compress(encoded, 1)


def unpacked_array(data: bytes | memoryview) -> bytes:
    """Return the encoded array. Raises `ValueError`: it is damaged."""
    try:
        check_unpacked_size(data, zstandard.frame_content_size(data))
        return zstandard.decompress(data)
    except (zstandard.ZstdError, MemoryError) as error:
        raise ValueError(f"an array that cannot be unpacked: {error}") from error


def check_unpacked_size(data: bytes | memoryview, claimed: int) -> None:
    """Raise `ValueError` for data that unpack to another size than claimed, or to more than a map can need."""
    found = zstandard.frame_content_size(data)
    if found != claimed or not 0 <= found <= _MOST_CHUNK_BYTES:
        raise ValueError(f"a chunk unpacks to {found} bytes, says {claimed}")


class _Cache:
    # Few and small chunks; always the last one.
    def __init__(self) -> None:
        self._chunks: OrderedDict[int, tuple[list[FileMessage], int]] = OrderedDict()
        self._num_bytes = 0

    def get(self, chunk: int) -> list[FileMessage] | None:
        if chunk not in self._chunks:
            return None
        self._chunks.move_to_end(chunk)
        return self._chunks[chunk][0]

    def keep(self, chunk: int, value: list[FileMessage], num_bytes: int) -> None:
        self._chunks[chunk] = value, num_bytes
        self._num_bytes += num_bytes
        while len(self._chunks) > 1 and (len(self._chunks) > _CACHED_CHUNKS or self._num_bytes > _CACHED_BYTES):
            self._num_bytes -= self._chunks.popitem(last=False)[1][1]


def _scan(data: Any, path: Path) -> list[ChunkPlace]:
    # A chunk is whole if its record is there and the index after it.
    if len(data) < len(MAGIC):
        return []
    if data[: len(MAGIC)] != MAGIC:
        raise MapFolderError(f"{path} is no MCAP file; play the log again")
    places: list[ChunkPlace] = []
    at, chunk = len(MAGIC), None
    while at + 9 <= len(data):
        opcode, length = _HEADER.unpack_from(data, at)
        start, end = at + 9, at + 9 + length
        if end > len(data):
            break
        if opcode == Opcode.CHUNK and length >= 16:
            chunk = (start, end, struct.unpack_from("<Q", data, start)[0])
        elif opcode == Opcode.DATA_END:
            # A resumed run cuts off the rest.
            break
        elif opcode == Opcode.MESSAGE_INDEX and chunk is not None and length >= 2:
            channel = struct.unpack_from("<H", data, start)[0]
            places.append(ChunkPlace(chunk[0], chunk[1], channel, chunk[2]))
            chunk = None
        at = end
    return places


_Place = tuple[int, int]


class StoredPart(NamedTuple):
    """A record or array of a checkpoint, its place (chunk, number in it), and the places it refers to."""

    place: _Place
    part: Any
    references: list[_Place]


class Journal:
    """An open journal, as far as it was whole when it was opened; use `with`.

    Raises `MapFolderError`: there is none, or it has another format.
    """

    def __init__(self, folder: Path) -> None:
        self._chunks = JournalChunks(folder)
        self.path = self._chunks.path
        self._places = self._chunks.places
        self._steps = [i for i, place in enumerate(self._places) if place.is_step]
        self._known_parts: dict[tuple[int, int], Any] = {}
        self._is_checked = False
        #: Of the checkpoint that was read last, with unread arrays.
        self.parts: list[StoredPart] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        # The file is closed with the last unread array.
        del self._chunks

    def __len__(self) -> int:
        return len(self._steps)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """The stamp of every step."""
        return np.array([self._places[i].stamp_ns for i in self._steps], dtype=np.int64)

    @property
    def num_bytes(self) -> int:
        """Number of whole bytes of the file."""
        return self._places[-1].end if self._places else 0

    def entry(self, index: int) -> JournalEntry:
        """Return a step with its events. Raises `MapFolderError`: it is damaged."""
        others = self._chunks.messages(self._steps[index])[1:]
        known = [message for message in others if message.channel in EVENT_NAMES]
        events = [self._decoded(message.data, EVENT_NAMES[message.channel]) for message in known]
        return JournalEntry(step=self.step(index), events=tuple(events), told=self.told(index))

    def told(self, index: int) -> Told | None:
        """Return the decisions of a step without its events."""
        messages = self._chunks.messages(self._steps[index])
        return next((self._decoded(m.data, "Told") for m in messages if m.channel == TOLD), None)

    def step(self, index: int) -> Step:
        """Return a step without its events."""
        step: Step = self._decoded(self._chunks.messages(self._steps[index])[0].data, "Step")
        return step

    def events(self, index: int, kind: str, *, has_points: bool = True) -> list[Event]:
        """Return the events of one kind in a step; `has_points=False` leaves out points that returns would give."""
        messages = [m for m in self._chunks.messages(self._steps[index]) if m.channel == CHANNELS[kind]]
        return [self._decoded(message.data, kind, has_points=has_points) for message in messages]

    def color(self, index: int) -> bytes | None:
        """Return the compressed image of a step's keyframe, None where there is none."""
        messages = self._chunks.messages(self._steps[index])
        return next((bytes(message.data) for message in messages if message.channel == COLOR), None)

    def checkpoint_before(self, index: int, *, reads_later: bool = False) -> tuple[int, Checkpoint] | None:
        """Return the last checkpoint at or before a step, and the step it follows; None if there is none.

        `reads_later`: arrays of clouds and spaces are read on first use, and damage is reported then.

        Raises `MapFolderError`: it is damaged.
        """
        following = self._steps[index + 1] if index + 1 < len(self._steps) else len(self._places)
        for chunk in range(following - 1, -1, -1):
            if self._places[chunk].channel == CHECKPOINT:
                return bisect_right(self._steps, chunk) - 1, self._checkpoint(chunk, reads_later=reads_later)
        return None

    def known(self, index: int) -> Known:
        """Return the places of all public records of the map after a step.

        Raises `MapFolderError`: it is damaged, or has no such records.
        """
        changes: list[Known] = []
        while not changes or not changes[-1].is_whole:
            chunk = self._steps[index] - 1 if index >= 0 else -1
            if chunk < 0 or self._places[chunk].channel != KNOWN:
                raise MapFolderError(f"{self.path} has no records of step {index}: play the log again")
            changes.append(self._decoded(self._chunks.messages(chunk)[0].data, "Known"))
            index -= 1
        objects: dict[int, tuple[int, int]] = {}
        submaps: dict[int, tuple[int, int]] = {}
        for change in reversed(changes):
            objects = {key: place for key, place in objects.items() if key not in change.gone_objects}
            submaps = {key: place for key, place in submaps.items() if key not in change.gone_submaps}
            objects |= change.objects
            submaps |= change.submaps
        return replace(changes[0], is_whole=True, objects=objects, submaps=submaps, gone_objects=(), gone_submaps=())

    def known_record(self, place: tuple[int, int], kind: type) -> Any:
        """Return the record at a place of `known`; shared parts are one object.

        Raises `MapFolderError`: it is damaged, or no record of this kind.
        """

        def part(chunk: int, number: int) -> Any:
            # What a record refers to was written before it.
            if not (0, 1) <= (chunk, number) < place:
                raise ValueError(f"a part is said to be number {number} of chunk {chunk}")
            if (chunk, number) not in self._known_parts:
                self._known_parts[chunk, number] = decode(bytes(self._chunks.messages(chunk)[number].data), part)
            return self._known_parts[chunk, number]

        try:
            if not 0 <= place[0] < len(self._places) or self._places[place[0]].channel != KNOWN or place[1] < 1:
                raise ValueError(f"a record is said to be number {place[1]} of chunk {place[0]}")
            data = self._chunks.messages(place[0])[place[1]].data
        except (ValueError, IndexError) as error:
            raise MapFolderError(f"{self.path} is damaged or of another version: {error}") from error
        return self._decoded(data, kind.__name__, part)

    def entries(self, first: int = 0) -> Iterator[JournalEntry]:
        """Yield the steps from one on."""
        for index in range(first, len(self)):
            yield self.entry(index)

    def cut_to_resumable(self) -> None:
        """Leave out steps that cannot be continued: after the first damage, or committed at a stop."""
        if self._is_checked:
            return
        for chunk, place in enumerate(self._places):
            try:
                first = self._chunks.messages(chunk, keeps=False)[0]
                is_last = place.is_step and self._decoded(first.data, "Step").kind is StepKind.CLOSING
            except MapFolderError:
                is_last = True
            if is_last:
                self._places = self._places[:chunk]
                self._steps = [i for i in self._steps if i < chunk]
                break
        self._is_checked = True

    @property
    def is_whole(self) -> bool:
        """Whether no chunk of the file is left out."""
        return len(self._places) == len(self._chunks.places)

    @property
    def num_chunks(self) -> int:
        """Number of chunks."""
        return len(self._places)

    def last_records(self) -> bytes:
        """Return the stored records of the last chunk. Raises `MapFolderError`: it is damaged."""
        return self._chunks.records(len(self._places) - 1)

    def read_copy(self) -> None:
        """Continue in the folder's current file, a copy of this one."""
        self._chunks.read_copy()

    def _checkpoint(self, chunk: int, *, reads_later: bool) -> Checkpoint:
        parts: dict[tuple[int, int], Any] = {}
        chunks = self._chunks

        def part(other: int, number: int) -> Any:
            place = (other, number)
            if place not in parts:
                parts[place] = decode(stored[place], part, later) if place in stored else array(PartPlace(*place))
            return parts[place]

        def array(place: PartPlace) -> NDArray[Any]:
            try:
                data = unpacked_array(chunks.messages(place.chunk)[place.number].data)
                return as_array(decode(data), place.length)
            except (ValueError, IndexError) as error:
                raise MapFolderError(f"{chunks.path} is damaged or of another version: {error}") from error

        later = LazyRecords(array, self.path) if reads_later else None
        try:
            stored, references = self._with_parts(chunk, later)
            checkpoint: Checkpoint = self._decoded(stored[chunk, 0], "Checkpoint", part, later)
            if later is not None:
                self.parts = [StoredPart(place, known, references.get(place, [])) for place, known in parts.items()]
                for place in [place for place in stored if self._places[place[0]].channel == ARRAYS]:
                    del stored[place]
            return replace(checkpoint, core=unpacked(checkpoint.core))
        except (ValueError, LookupError) as error:
            raise MapFolderError(f"{self.path} is damaged or of another version: {error}") from error

    def _with_parts(
        self, chunk: int, later: LazyRecords | None
    ) -> tuple[dict[_Place, bytes], dict[_Place, list[_Place]]]:
        # The parts of a large map lie in hundreds of chunks. No part refers to a later chunk than its own: each is
        # unpacked once, the latest first, and only needed parts are kept, without the arrays that `later` leaves.
        stored: dict[_Place, bytes] = {}
        references: dict[_Place, list[_Place]] = {}
        wanted = {chunk: {0}}
        while wanted:
            here = max(wanted)
            numbers = wanted.pop(here)
            messages = self._chunks.messages(here, keeps=False)
            if self._places[here].channel == ARRAYS:
                stored |= {(here, number): unpacked_array(messages[number].data) for number in numbers}
                continue
            while numbers:
                number = numbers.pop()
                stored[here, number] = data = bytes(messages[number].data)
                references[here, number] = part_references(data, later)
                for other, its_number in references[here, number]:
                    if type(other) is not int or not 0 <= other <= here:
                        raise ValueError(f"a part is said to lie in chunk {other}")
                    # The first message is the document, which no part refers to.
                    if type(its_number) is not int or its_number < 1:
                        raise ValueError(f"a part is said to be number {its_number}")
                    if (other, its_number) not in stored:
                        (numbers if other == here else wanted.setdefault(other, set())).add(its_number)
        return stored, references

    def _decoded(
        self,
        data: bytes | memoryview,
        kind: str,
        part: Callable[[int, int], Any] | None = None,
        later: LazyRecords | None = None,
        *,
        has_points: bool = True,
    ) -> Any:
        try:
            record = decode(bytes(data), part, later)
            if isinstance(record, PackedFrame):
                record = unpacked_frame(record) if has_points else record.event
        except ValueError as error:
            raise MapFolderError(f"{self.path} is damaged or of another version: {error}") from error
        if type(record).__name__ != kind:
            raise MapFolderError(
                f"{self.path} is damaged or of another version: found a {type(record).__name__}, expected a {kind}"
            )
        return record
