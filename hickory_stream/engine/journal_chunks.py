"""The chunks of a journal's file, each unpacked when it is asked for; `journal_format` describes them.

Whoever holds them can read them: the file stays open as long as arrays of it have still to be read.
"""

from __future__ import annotations

import mmap
import os
import struct
from collections import OrderedDict
from dataclasses import dataclass
from io import BytesIO
from threading import Lock
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, Message
from mcap.stream_reader import breakup_chunk, get_chunk_data_stream

from hickory_stream.confined import OutsideError, open_within
from hickory_stream.engine.journal_format import JOURNAL, MAGIC, STEP
from hickory_stream.errors import MapFolderError

if TYPE_CHECKING:
    from pathlib import Path

_Kept = TypeVar("_Kept")
_CACHED_CHUNKS, _CACHED_BYTES = 64, 64 << 20
# A chunk that claims to unpack to more is none of ours: the state of a large map takes some tens of megabytes.
_MOST_CHUNK_BYTES = 1 << 29
_HEADER = struct.Struct("<BQ")
_MESSAGE_HEADER_BYTES = 2 + 4 + 8 + 8
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
class ChunkPlace:
    """Where a chunk is in the file."""

    start: int
    end: int
    channel: int
    stamp_ns: int

    @property
    def is_step(self) -> bool:
        """Whether it holds a step of the run."""
        return self.channel == STEP


class JournalChunks:
    """The chunks of the journal in a folder that were whole when it was opened, at their `places`.

    Raises:
        MapFolderError: there is no journal, or it is none of this format.
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
        self.places = _scan(self._data, self.path)
        self._messages: _Cache[list[Message]] = _Cache()
        self._contents: _Cache[list[memoryview]] = _Cache()
        self._lock = Lock()

    def messages(self, chunk: int) -> list[Message]:
        """Return the messages of a chunk.

        Raises:
            MapFolderError: it is damaged.
        """
        with self._lock:
            known = self._messages.get(chunk)
            if known is not None:
                return known
            place = self.places[chunk]
            try:
                records = breakup_chunk(self._record(place), validate_crc=True)
                messages = [record for record in records if isinstance(record, Message)]
                if not messages:
                    raise ValueError("a chunk without messages")
            except _DAMAGE as error:
                raise self._damage(place, error) from error
            self._messages.keep(chunk, messages, sum(len(message.data) for message in messages))
            return messages

    def contents(self, chunk: int, *, keeps: bool = True) -> list[memoryview]:
        """Return what the messages of a chunk hold, which takes a fraction of the time of the messages themselves.

        `keeps`: it is at hand when it is asked for again.

        Raises:
            MapFolderError: it is damaged.
        """
        with self._lock:
            known = self._contents.get(chunk)
            if known is not None:
                return known
            records = self.records(chunk)
            try:
                contents = _contents_of(memoryview(records))
                if not contents:
                    raise ValueError("a chunk without messages")
            except _DAMAGE as error:
                raise self._damage(self.places[chunk], error) from error
            if keeps:
                self._contents.keep(chunk, contents, len(records))
            return contents

    def records(self, chunk: int) -> bytes:
        """Return the records of a chunk as they are, one after another.

        Raises:
            MapFolderError: it is damaged.
        """
        place = self.places[chunk]
        try:
            stream, length = get_chunk_data_stream(self._record(place), validate_crc=True)
            return bytes(stream.read(length))
        except _DAMAGE as error:
            raise self._damage(place, error) from error

    def read_copy(self) -> None:
        """Read from the file that is in the folder now, which begins with as many of these chunks as it has."""
        copy = JournalChunks(self.path.parent)
        with self._lock:
            self._data, self.places = copy._data, copy.places

    def _record(self, place: ChunkPlace) -> Chunk:
        """Return the chunk at a place; raises ValueError where it declares another size than it has or may have."""
        chunk = Chunk.read(ReadDataStream(BytesIO(self._data[place.start : place.end])))
        if chunk.compression != "zstd":
            raise ValueError(f"a chunk is packed by {chunk.compression or 'nothing'!r}, expected zstd")
        check_unpacked_size(chunk.data, chunk.uncompressed_size)
        return chunk

    def _damage(self, place: ChunkPlace, error: BaseException) -> MapFolderError:
        return MapFolderError(f"{self.path} is damaged at byte {place.start}: {error}; play the log again")


def packed_array(encoded: bytes) -> bytes:
    """Return an encoded array as a chunk of arrays holds it."""
    return zstandard.compress(encoded)


def unpacked_array(data: memoryview) -> bytes:
    """Return the encoded array that was packed.

    Raises:
        ValueError: it is damaged.
    """
    try:
        check_unpacked_size(data, zstandard.frame_content_size(data))
        return zstandard.decompress(data)
    except (zstandard.ZstdError, MemoryError) as error:
        raise ValueError(f"an array that cannot be unpacked: {error}") from error


def check_unpacked_size(data: bytes | memoryview, claimed: int) -> None:
    """Refuse what unpacks to another size than was claimed, or to more than a map can need.

    Raises:
        ValueError: it does.
    """
    found = zstandard.frame_content_size(data)
    if found != claimed or not 0 <= found <= _MOST_CHUNK_BYTES:
        raise ValueError(f"a chunk unpacks to {found} bytes, says {claimed}")


class _Cache(Generic[_Kept]):
    """The chunks that were asked for last, as far as they are few and small; always the last one."""

    def __init__(self) -> None:
        self._chunks: OrderedDict[int, tuple[_Kept, int]] = OrderedDict()
        self._num_bytes = 0

    def get(self, chunk: int) -> _Kept | None:
        if chunk not in self._chunks:
            return None
        self._chunks.move_to_end(chunk)
        return self._chunks[chunk][0]

    def keep(self, chunk: int, value: _Kept, num_bytes: int) -> None:
        self._chunks[chunk] = value, num_bytes
        self._num_bytes += num_bytes
        while len(self._chunks) > 1 and (len(self._chunks) > _CACHED_CHUNKS or self._num_bytes > _CACHED_BYTES):
            self._num_bytes -= self._chunks.popitem(last=False)[1][1]


def _contents_of(data: memoryview) -> list[memoryview]:
    found: list[memoryview] = []
    at = 0
    while at < len(data):
        opcode, length = _HEADER.unpack_from(data, at)
        at += _HEADER.size
        if length > len(data) - at or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEADER_BYTES):
            raise ValueError(f"a record of {length} bytes at byte {at} of {len(data)}")
        if opcode == Opcode.MESSAGE:
            found.append(data[at + _MESSAGE_HEADER_BYTES : at + length])
        at += length
    return found


def _scan(data: Any, path: Path) -> list[ChunkPlace]:
    """Return the chunks that are whole: the record is there, and the index after it, which says what is in it."""
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
            # After it is what a run that goes on cuts off: nobody reads there while it does.
            break
        elif opcode == Opcode.MESSAGE_INDEX and chunk is not None and length >= 2:
            channel = struct.unpack_from("<H", data, start)[0]
            places.append(ChunkPlace(chunk[0], chunk[1], channel, chunk[2]))
            chunk = None
        at = end
    return places
