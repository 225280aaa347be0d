"""ROS 1 bags, whole or damaged: indexed, unindexed, cut off, uncompressed, bz2 or lz4.

The library rosbags refuses a bag with a damaged index. Here all records are read where no index fits.
Bags have no checksums: a message is rejected if its place or connection differs from the chunk's index.
"""

import mmap
import re
import struct
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from hickory_stream.errors import RecordingError
from players.logs.containers import LogMessage, Topic, merged_topics, normalized_type, summed_by
from players.logs.decompression import UnpackError, release, unpack
from players.logs.log_damage import Flaws
from players.logs.log_parts import Parts, span_of
from players.profile import Profile

MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _BAG, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 3, 4, 5, 6, 7
_CHUNK_OP = re.compile(rb"\x04\x00\x00\x00op=\x05")
_MAX_HEADER_BYTES = 1 << 20
_LOOKED_AT = 32
_SIZE = struct.Struct("<I")


class _NoRecordError(Exception):
    """Bytes that are no record."""


class _WrongIndexError(Exception):
    """The index refers to a chunk that is not there."""


@dataclass(slots=True)
class _Chunk:
    # `index` is (connection, log time) by offset.
    offset: int
    data_at: int
    data_end: int
    compression: str
    size: int
    index: dict[int, tuple[int, int]] = field(default_factory=dict)
    index_end: int = 0

    @property
    def counts(self) -> Counter[int]:
        return Counter(connection for connection, _ in self.index.values())


class Ros1Log:
    """A `Log` in one ROS 1 bag."""

    kind = "ROS 1 bag"
    #: What its writer is known for, if messages of the bag describe its cameras.
    profile: Profile | None = None
    #: None of the bag; bz2 and (optionally) lz4 have their own.
    checksum = ""
    #: What is read of a long log; None: all.
    parts: Parts | None = None

    def __init__(self, path: Path) -> None:
        """Read the index, or all records if no index fits. Raises `RecordingError`: not one connection can be read."""
        self.path = path
        self.files = (path,)
        self.flaws = Flaws(path.name)
        self._connections: dict[int, Topic] = {}
        self._declared: Counter[int] | None = None
        self._chunk_places: list[int] = []
        #: First and last log time of chunks, and the connections in them.
        self._chunk_infos: dict[int, tuple[int, int, frozenset[int]]] = {}
        self._is_indexed = True
        with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            if not self._read_index(data):
                self._is_indexed = False
                self._connections.clear()
                self._declared = None
                self._walk_whole(data)
        if not self._connections and len(self.flaws):
            first = next(iter(self.flaws))
            raise RecordingError(
                f"{path} is cut off or damaged, and no connection in it can be read ({first.what} at byte "
                f"{first.offset}); expected at least one whole chunk"
            )
        self.topics = self._topics()

    def declared(self) -> dict[str, int] | None:
        """Return the declared number of messages of each topic, None without an index."""
        return summed_by(self._name, self._declared)

    def span_ns(self) -> tuple[int, int] | None:
        """Return the first and the last log time; None if no index has them."""
        return span_of([info[:2] for info in self._chunk_infos.values() if info[2]])

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics in the order of the file; unreadable ones are noted in `flaws`."""
        read: set[int] = set()
        with self.path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            try:
                yield from self._chunks(data, set(topics), read)
            except _WrongIndexError:
                self._is_indexed = False
                self._chunk_places.clear()
                self._walk_whole(data)
                yield from self._chunks(data, set(topics), read)

    def _chunks(self, data: mmap.mmap, topics: set[str], read: set[int]) -> Iterator[LogMessage]:
        names = {number: topic.name for number, topic in self._connections.items() if topic.name in topics}
        for place in self._chunk_places:
            if place in read or not self._has_part(place):
                continue
            try:
                chunk = _chunk_at(data, place)
            except _NoRecordError as error:
                if self._is_indexed:
                    raise _WrongIndexError from error
                self.flaws.note(place, f"a chunk is not there: {error}", 0)
                continue
            read.add(place)
            if chunk.index and not any(connection in names for connection, _ in chunk.index.values()):
                continue
            try:
                content = _unpacked(data, chunk)
            except UnpackError as error:
                self._bad_chunk(chunk, str(error))
                continue
            yield from self._content(content, chunk, names)
            release(data, chunk.offset, chunk.data_end)

    def _has_part(self, place: int) -> bool:
        if self.parts is None or place not in self._chunk_infos:
            return True
        first_ns, last_ns, connections = self._chunk_infos[place]
        return self.parts.meets(first_ns, last_ns) or any(self._name(one) in self.parts.whole for one in connections)

    def chunk_spans(self, data: mmap.mmap) -> list[tuple[tuple[int, int], int]]:
        """Return where each chunk and the index behind it begin and end, and how many messages it has."""
        chunks = [_chunk_at(data, place) for place in self._chunk_places]
        return [((chunk.offset, chunk.index_end), len(chunk.index)) for chunk in chunks]

    def _content(self, content: Any, chunk: _Chunk, names: dict[int, str]) -> Iterator[LogMessage]:
        view, at, end = memoryview(content), 0, len(content)
        starts = sorted(chunk.index)
        lost: Counter[str] = Counter()
        first_bad: int | None = None
        while at < end:
            try:
                header, data_at, data_end = _record(view, at, end)
                connection = self._checked(header, at, data_end, chunk, end, view)
            except _NoRecordError:
                first_bad = at if first_bad is None else first_bad
                if at in chunk.index:
                    lost[self._name(chunk.index[at][0])] += 1
                at = next((start for start in starts if start > at), end)
                continue
            if connection in names:
                name, log_ns = names[connection], _stamp_ns(header)
                if self.parts is None or self.parts.wants(name, log_ns):
                    yield LogMessage(name, log_ns, view[data_at:data_end])
            at = data_end
        if first_bad is not None:
            what = f"records in a chunk that its index does not confirm, the first at byte {first_bad} of it"
            self.flaws.note(chunk.offset, what, 0, lost)

    def _checked(
        self, header: dict[bytes, bytes], at: int, data_end: int, chunk: _Chunk, end: int, view: memoryview
    ) -> int | None:
        op = _op(header)
        if op == _CONNECTION:
            self._learn(header, view[:0])
            return None
        if op != _MESSAGE:
            raise _NoRecordError("neither a message nor a connection")
        connection = _number(header, b"conn")
        if connection not in self._connections or len(header.get(b"time", b"")) != 8:
            raise _NoRecordError("a message of an unknown connection")
        if chunk.index:
            if chunk.index.get(at) != (connection, _stamp_ns(header)):
                raise _NoRecordError("a message that the index does not have")
            if data_end != end and data_end not in chunk.index and not _is_connection_at(view, data_end, end):
                raise _NoRecordError("a message of another length than the index has")
        return connection

    def _read_index(self, data: mmap.mmap) -> bool:
        try:
            header, _, at = _record(data, len(MAGIC), len(data))
            index_at, num_connections, num_chunks = (
                int.from_bytes(header.get(name, b""), "little")
                for name in (b"index_pos", b"conn_count", b"chunk_count")
            )
            if _op(header) != _BAG or not at <= index_at <= len(data) or not index_at:
                return False
            declared: Counter[int] = Counter()
            at = index_at
            while at < len(data):
                header, data_at, at = _record(data, at, len(data))
                if _op(header) == _CONNECTION:
                    self._learn(header, data[data_at:at])
                elif _op(header) == _CHUNK_INFO:
                    counts = dict(struct.iter_unpack("<II", data[data_at:at]))
                    declared.update(counts)
                    self._add_chunk(
                        int.from_bytes(header[b"chunk_pos"], "little"),
                        [_time_ns(header[name]) for name in (b"start_time", b"end_time")],
                        counts,
                    )
                else:
                    return False
        except (_NoRecordError, KeyError, struct.error):
            self._chunk_places.clear()
            return False
        self._declared = declared
        is_whole = len(self._connections) == num_connections and len(self._chunk_places) == num_chunks
        # In an overwritten bag, chunks are not where the index says. Only a few are checked here, the others when they
        # are read: checking all chunks of a long bag would take minutes on a disk.
        self._chunk_places.sort()
        step = max(1, len(self._chunk_places) // _LOOKED_AT)
        if not is_whole or not all(_is_chunk(data, place) for place in self._chunk_places[::step]):
            self._chunk_places.clear()
            return False
        return True

    def _walk_whole(self, data: mmap.mmap) -> None:
        at, end = len(MAGIC), len(data)
        while at < end:
            try:
                header, data_at, data_end = _record(data, at, end, is_cut_off_well=True)
                op = _op(header)
                if op == _CHUNK:
                    self._learn_chunk(data, at)
                    (declared,) = _SIZE.unpack_from(data, data_at - 4)
                    if declared != data_end - data_at:
                        missing = declared - (data_end - data_at)
                        what = f"the bag is cut off within a chunk, of which {missing} bytes are missing"
                        self.flaws.note(at, what, 0)
                elif data_end != data_at + _SIZE.unpack_from(data, data_at - 4)[0]:
                    raise _NoRecordError("data beyond the end")
                elif op == _CONNECTION:
                    self._learn(header, data[data_at:data_end])
                elif op not in (_BAG, _INDEX, _CHUNK_INFO):
                    raise _NoRecordError("no record of a bag")
            except _NoRecordError:
                following = _next_chunk(data, at + 1)
                what = "bytes that are no record" if following < end else "the bag is cut off"
                self.flaws.note(at, what, following - at)
                at = following
            else:
                at = data_end

    def _learn_chunk(self, data: mmap.mmap, at: int) -> None:
        chunk = _chunk_at(data, at)
        self._add_chunk(at, [log_ns for _, log_ns in chunk.index.values()], chunk.counts)
        if chunk.index and all(connection in self._connections for connection, _ in chunk.index.values()):
            return
        try:
            content = _unpacked(data, chunk)
        except UnpackError as error:
            self._bad_chunk(chunk, str(error))
            return
        inner, end = 0, len(content)
        while inner < end:
            try:
                header, data_at, inner = _record(content, inner, end)
                if _op(header) == _CONNECTION:
                    self._learn(header, content[data_at:inner])
            except _NoRecordError:
                return

    def _add_chunk(self, place: int, times_ns: Sequence[int], connections: Collection[int]) -> None:
        self._chunk_places.append(place)
        if times_ns:
            self._chunk_infos[place] = min(times_ns), max(times_ns), frozenset(connections)

    def _learn(self, header: dict[bytes, bytes], content: Any) -> None:
        number = _number(header, b"conn")
        if number in self._connections or not len(content):
            return
        try:
            fields = _fields(bytes(content))
            name = header[b"topic"].decode()
            type_name = fields[b"type"].decode()
            definition = fields.get(b"message_definition", b"").decode("utf-8", errors="replace")
        except (_NoRecordError, KeyError, UnicodeDecodeError):
            return
        self._connections[number] = Topic(
            name=name, type_name=normalized_type(type_name), wire="ros1", definition_format="msg", definition=definition
        )

    def _topics(self) -> tuple[Topic, ...]:
        counts = self._declared
        if counts is None:
            counts = Counter()
            with self.path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
                for place in self._chunk_places:
                    counts.update(_chunk_at(data, place).counts)
        is_known = self._declared is not None or bool(counts)
        return merged_topics(
            replace(topic, num_messages=counts.get(number, 0) if is_known else None)
            for number, topic in self._connections.items()
        )

    def _name(self, connection: int) -> str:
        topic = self._connections.get(connection)
        return topic.name if topic else ""

    def _bad_chunk(self, chunk: _Chunk, reason: str) -> None:
        num_bytes = chunk.data_end - chunk.offset
        self.flaws.note(chunk.offset, f"a chunk {reason}", num_bytes, summed_by(self._name, chunk.counts))


def _unpacked(data: mmap.mmap, chunk: _Chunk) -> Any:
    if chunk.compression in ("", "none"):
        return unpack("none", data[chunk.data_at : chunk.data_end], chunk.size)
    with memoryview(data) as view, view[chunk.data_at : chunk.data_end] as packed:
        return unpack(chunk.compression, packed, chunk.size)


def _record(data: Any, at: int, end: int, *, is_cut_off_well: bool = False) -> tuple[dict[bytes, bytes], int, int]:
    # `is_cut_off_well`: data that exceeds the end is accepted as far as it is there.
    if at + 4 > end:
        raise _NoRecordError("too short")
    (header_bytes,) = _SIZE.unpack_from(data, at)
    at += 4
    if header_bytes > _MAX_HEADER_BYTES or at + header_bytes + 4 > end:
        raise _NoRecordError("a header beyond the end")
    header = _fields(bytes(data[at : at + header_bytes]))
    at += header_bytes
    (data_bytes,) = _SIZE.unpack_from(data, at)
    at += 4
    if data_bytes > end - at and not is_cut_off_well:
        raise _NoRecordError("data beyond the end")
    return header, at, min(at + data_bytes, end)


def _fields(header: bytes) -> dict[bytes, bytes]:
    fields, at, end = {}, 0, len(header)
    while at < end:
        if at + 4 > end:
            raise _NoRecordError("a field that is cut off")
        (size,) = _SIZE.unpack_from(header, at)
        name, is_field, value = header[at + 4 : at + 4 + size].partition(b"=")
        if not is_field or at + 4 + size > end:
            raise _NoRecordError("a field without a value")
        fields[name] = value
        at += 4 + size
    return fields


def _op(header: dict[bytes, bytes]) -> int:
    return _number(header, b"op")


def _number(header: dict[bytes, bytes], name: bytes) -> int:
    if name not in header:
        raise _NoRecordError(f"no field {name.decode()}")
    return int.from_bytes(header[name], "little")


def _stamp_ns(header: dict[bytes, bytes]) -> int:
    return _time_ns(header[b"time"])


def _time_ns(time: bytes) -> int:
    seconds, nanoseconds = struct.unpack("<II", time)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _is_connection_at(view: memoryview, at: int, end: int) -> bool:
    try:
        return _op(_record(view, at, end)[0]) == _CONNECTION
    except _NoRecordError:
        return False


def _is_chunk(data: Any, at: int) -> bool:
    try:
        _chunk_at(data, at, with_index=False)
    except _NoRecordError:
        return False
    return True


def _chunk_at(data: Any, at: int, *, with_index: bool = True) -> _Chunk:
    end = len(data)
    header, data_at, data_end = _record(data, at, end, is_cut_off_well=True)
    if _op(header) != _CHUNK:
        raise _NoRecordError("no chunk")
    chunk = _Chunk(at, data_at, data_end, header.get(b"compression", b"").decode("ascii", "replace"), 0)
    chunk.size = _number(header, b"size")
    (declared,) = _SIZE.unpack_from(data, data_at - 4)
    if declared != data_end - data_at:
        # The last chunk of a truncated bag: an uncompressed one is read up to its end.
        if chunk.compression != "none" or declared != chunk.size:
            raise _NoRecordError("a chunk beyond the end")
        chunk.size = data_end - data_at
    place = data_end
    while with_index and place < end:
        try:
            header, data_at, place = _record(data, place, end)
            if _op(header) != _INDEX:
                break
            connection = _number(header, b"conn")
        except _NoRecordError:
            break
        for seconds, nanoseconds, offset in struct.iter_unpack("<III", data[data_at : place - (place - data_at) % 12]):
            chunk.index[offset] = (connection, seconds * 1_000_000_000 + nanoseconds)
        chunk.index_end = place
    return chunk


def _next_chunk(data: mmap.mmap, start: int) -> int:
    for match in _CHUNK_OP.finditer(data, start):
        # The fields of a header come in any order: the record begins somewhere before this one.
        for at in range(max(start, match.start() - 64), match.start() - 3):
            (size,) = _SIZE.unpack_from(data, at)
            if size < 128 and _is_chunk(data, at):
                return at
    return len(data)
