"""MCAP files, whole or damaged, in the order of the file, with every checksum verified.

A bad chunk is skipped. The index at the end is used as long as it fits the file; else all records are read.
After damaged bytes, reading resumes at the next chunk.
"""

import mmap
import re
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hickory_stream.errors import RecordingError
from players.logs import mcap_records as mcap
from players.logs.containers import LogMessage, Topic, merged_topics, summed_by
from players.logs.decompression import UnpackError, release, unpack_message
from players.logs.log_damage import Flaws
from players.logs.log_parts import Parts, span_of

_FOOTER_BYTES = mcap.HEAD.size + 20
_CHUNK_PATTERN = re.compile(rb"\x06(?=[\s\S]{5}\x00{3}[\s\S]{28}(?:\x00{4}|\x03\x00{3}lz4|\x04\x00{3}zstd))")
_RECORD_PATTERN = re.compile(rb"[\x03-\x05\x0f](?=[\s\S]{4}\x00{4})")


@dataclass(slots=True)
class _Chunk:
    # `counts` by channel id, None without an index
    offset: int
    num_bytes: int
    #: The first and the last log time.
    span_ns: tuple[int, int]
    counts: dict[int, int] | None = None


@dataclass(slots=True)
class _Survey(mcap.Described):
    chunks: list[_Chunk] = field(default_factory=list)
    loose_counts: Counter[int] = field(default_factory=Counter)
    declared: dict[int, int] | None = None
    is_indexed: bool = False
    span_ns: tuple[int, int] | None = None


class _WrongIndexError(Exception):
    """The index refers to a chunk that is not there."""


class McapLog:
    """A `Log` in one MCAP file."""

    kind = "MCAP"
    #: What is read of a long log; None: all.
    parts: Parts | None = None

    def __init__(self, path: Path) -> None:
        """Read the summary; without a valid one, all records are read to find the channels.

        Raises `RecordingError`: not one channel can be read.
        """
        self.path = path
        self.files = (path,)
        self.flaws = Flaws(path.name)
        self._survey = _Survey()
        with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            self._survey = _read_summary(data) or self._walk_whole(data)
            is_cut_off = data[-len(mcap.MAGIC) :] != mcap.MAGIC
            if not self._survey.channels and len(self.flaws):
                found = "is cut off: its end is missing" if is_cut_off else "is damaged"
                first = next(iter(self.flaws))
                raise RecordingError(
                    f"{path} {found}, and no channel in it can be read ({first.what} at byte {first.offset}); "
                    "expected at least one whole chunk"
                )
        self.topics = self._topics()

    @property
    def checksum(self) -> str:
        """What protects the messages, in words; "" where nothing does."""
        return "CRC-32 per chunk" if self._survey.chunks else ""

    def declared(self) -> dict[str, int] | None:
        """Return the declared number of messages of each topic, None if the file declares none."""
        return summed_by(self._name, self._survey.declared)

    def span_ns(self) -> tuple[int, int] | None:
        """Return the first and the last log time; None if no index has them."""
        return span_of([chunk.span_ns for chunk in self._survey.chunks if chunk.counts]) or self._survey.span_ns

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics in the order of the file; unreadable ones are noted in `flaws`."""
        wanted = set(topics)
        with self.path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
            if not self._survey.chunks:
                yield from self._loose(data, wanted)
                return
            read: set[int] = set()
            try:
                yield from self._chunked(data, wanted, read)
            except _WrongIndexError:
                declared = self._survey.declared
                self._survey = self._walk_whole(data)
                self._survey.declared = declared
                yield from self._chunked(data, wanted, read)

    def chunk_spans(self, data: mmap.mmap) -> list[tuple[tuple[int, int], int]]:
        """Return the first and last byte of each chunk, and its number of messages by the index."""
        for chunk in self._survey.chunks:
            _is_chunk_at(data, chunk)
        return [((c.offset, c.offset + c.num_bytes), sum((c.counts or {}).values())) for c in self._survey.chunks]

    def _chunked(self, data: mmap.mmap, wanted: set[str], read: set[int]) -> Iterator[LogMessage]:
        survey = self._survey
        for chunk in survey.chunks:
            if chunk.offset in read or not self._has_part(chunk):
                continue
            if survey.is_indexed and not _is_chunk_at(data, chunk):
                raise _WrongIndexError
            read.add(chunk.offset)
            if chunk.counts and not any(self._name(channel) in wanted for channel in chunk.counts):
                continue
            try:
                records = mcap.unpacked_chunk(data, chunk.offset + mcap.HEAD.size, chunk.offset + chunk.num_bytes)
            except UnpackError as error:
                self._bad_chunk(chunk, str(error))
                continue
            yield from self._records(records, chunk, wanted)
            release(data, chunk.offset, chunk.offset + chunk.num_bytes)

    def _has_part(self, chunk: _Chunk) -> bool:
        if self.parts is None or self.parts.meets(*chunk.span_ns):
            return True
        return any(self._name(channel) in self.parts.whole for channel in chunk.counts or ())

    def _records(self, records: Any, chunk: _Chunk, wanted: set[str]) -> Iterator[LogMessage]:
        view, at, end = memoryview(records), 0, len(records)
        names = {channel: name for channel, (_, name, _) in self._survey.channels.items() if name in wanted}
        packable = {channel for channel in names if self._is_cdr(channel)}
        unknown, lost, parts = 0, Counter[str](), self.parts
        while at + mcap.HEAD.size <= end:
            opcode, length = mcap.HEAD.unpack_from(view, at)
            at += mcap.HEAD.size
            if length > end - at:
                break
            if opcode == mcap.MESSAGE_OP and length >= mcap.MESSAGE.size:
                channel, _, log_ns, _ = mcap.MESSAGE.unpack_from(view, at)
                name = names.get(channel)
                if name is not None and (parts is None or parts.wants(name, log_ns)):
                    content = view[at + mcap.MESSAGE.size : at + length]
                    if channel in packable:
                        try:
                            content = unpack_message(content)
                        except UnpackError as error:
                            lost[name] += 1
                            what = f"{lost.total()} messages in a chunk cannot be unpacked, the last {error}"
                            self.flaws.note(chunk.offset + 1, what, 0, lost)
                            at += length
                            continue
                    yield LogMessage(name, log_ns, content)
                elif name is None and channel not in self._survey.channels:
                    unknown += 1
            at += length
        if unknown:
            what = "messages of channels that no readable record describes"
            self.flaws.note(chunk.offset, what, 0, num_unknown=unknown)
        elif at != end:
            self.flaws.note(chunk.offset, "the chunk ends within a record", end - at)

    def _loose(self, data: mmap.mmap, wanted: set[str]) -> Iterator[LogMessage]:
        view, crc, crc_at = memoryview(data), 0, 0
        try:
            for opcode, at, length in self._walk(data):
                if opcode == mcap.MESSAGE_OP:
                    channel, _, log_ns, _ = mcap.MESSAGE.unpack_from(data, at)
                    name = self._name(channel)
                    if self.parts is not None and not self.parts.wants(name, log_ns):
                        continue
                    if name in wanted:
                        content = bytes(view[at + mcap.MESSAGE.size : at + length])
                        try:
                            yield LogMessage(
                                name, log_ns, unpack_message(content) if self._is_cdr(channel) else content
                            )
                        except UnpackError as error:
                            self.flaws.note(at, f"a message {error}", length, {name: 1})
                    elif channel not in self._survey.channels:
                        what = "a message of a channel that no readable record describes"
                        self.flaws.note(at, what, 0, num_unknown=1)
                elif opcode == mcap.DATA_END:
                    (expected,) = struct.unpack_from("<I", data, at)
                    if expected and self.parts is None:
                        crc = zlib.crc32(view[crc_at : at - mcap.HEAD.size], crc)
                    if crc != expected and self.parts is None:
                        what = "the checksum over all messages differs: at least one of them was altered"
                        self.flaws.note(at, what, 0)
        finally:
            view.release()

    def _walk_whole(self, data: mmap.mmap) -> _Survey:
        survey = _Survey()
        for opcode, at, length in self._walk(data):
            if opcode == mcap.CHUNK_OP:
                survey.chunks.append(
                    _Chunk(at - mcap.HEAD.size, length + mcap.HEAD.size, struct.unpack_from("<QQ", data, at))
                )
            elif opcode == mcap.INDEX and survey.chunks:
                channel, size = struct.unpack_from("<HI", data, at)
                last = survey.chunks[-1]
                last.counts = {**(last.counts or {}), channel: size // 16}
            elif opcode == mcap.MESSAGE_OP:
                channel, _, log_ns, _ = mcap.MESSAGE.unpack_from(data, at)
                survey.loose_counts[channel] += 1
                first_ns, last_ns = survey.span_ns or (log_ns, log_ns)
                survey.span_ns = min(first_ns, log_ns), max(last_ns, log_ns)
            elif opcode == mcap.STATISTICS:
                survey.declared = _statistics(data, at, length)
            elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
                mcap.learn(survey, opcode, data[at : at + length])
        for chunk in survey.chunks:
            if chunk.counts is None or not chunk.counts.keys() <= survey.channels.keys():
                self._learn_chunk(data, chunk, survey)
        return survey

    def _walk(self, data: mmap.mmap) -> Iterator[tuple[int, int, int]]:
        at, end = (len(mcap.MAGIC) if data[: len(mcap.MAGIC)] == mcap.MAGIC else 0), len(data)
        while at < end:
            if at + mcap.HEAD.size <= end:
                opcode, length = mcap.HEAD.unpack_from(data, at)
                if mcap.is_record(opcode, length, end - at - mcap.HEAD.size):
                    yield opcode, at + mcap.HEAD.size, length
                    at += mcap.HEAD.size + length
                    if opcode == mcap.FOOTER:
                        return
                    continue
            if data[at:end] == mcap.MAGIC[: end - at]:
                return
            following = _next_record(data, at + 1)
            what = "bytes that are no record" if following < end else "the file is cut off"
            self.flaws.note(at, what, following - at)
            at = following

    def _learn_chunk(self, data: mmap.mmap, chunk: _Chunk, survey: _Survey) -> None:
        try:
            records = mcap.unpacked_chunk(data, chunk.offset + mcap.HEAD.size, chunk.offset + chunk.num_bytes)
        except UnpackError as error:
            self._bad_chunk(chunk, str(error))
            return
        counts: Counter[int] = Counter()
        for opcode, at, length in mcap.records_in(records):
            if opcode == mcap.MESSAGE_OP and length >= mcap.MESSAGE.size:
                counts[mcap.MESSAGE.unpack_from(records, at)[0]] += 1
            elif opcode in (mcap.SCHEMA, mcap.CHANNEL):
                mcap.learn(survey, opcode, bytes(records[at : at + length]))
        chunk.counts = dict(counts)

    def _name(self, channel: int) -> str:
        known = self._survey.channels.get(channel)
        return known[1] if known else ""

    def _is_cdr(self, channel: int) -> bool:
        return self._survey.channels[channel][2] == "cdr"

    def _bad_chunk(self, chunk: _Chunk, reason: str) -> None:
        self.flaws.note(chunk.offset, f"a chunk {reason}", chunk.num_bytes, summed_by(self._name, chunk.counts))

    def _topics(self) -> tuple[Topic, ...]:
        survey = self._survey
        counts = survey.declared
        if counts is None:
            counts = Counter(survey.loose_counts)
            for chunk in survey.chunks:
                counts.update(chunk.counts or {})
        return merged_topics([mcap.topic_of(survey, channel, counts.get(channel, 0)) for channel in survey.channels])


def _read_summary(data: mmap.mmap) -> _Survey | None:
    tail = len(data) - len(mcap.MAGIC) - _FOOTER_BYTES
    if tail < len(mcap.MAGIC) or data[-len(mcap.MAGIC) :] != mcap.MAGIC or data[: len(mcap.MAGIC)] != mcap.MAGIC:
        return None
    opcode, length = mcap.HEAD.unpack_from(data, tail)
    start, _, crc = struct.unpack_from("<QQI", data, tail + mcap.HEAD.size)
    if opcode != mcap.FOOTER or length != 20 or not 0 < start < tail:
        return None
    if crc and zlib.crc32(data[start : len(data) - len(mcap.MAGIC) - 4]) != crc:
        return None
    survey, at = _Survey(is_indexed=True), start
    try:
        while at < tail:
            opcode, length = mcap.HEAD.unpack_from(data, at)
            at += mcap.HEAD.size
            if not mcap.is_record(opcode, length, tail - at):
                return None
            if opcode in (mcap.SCHEMA, mcap.CHANNEL):
                mcap.learn(survey, opcode, data[at : at + length])
            elif opcode == mcap.CHUNK_INDEX:
                survey.chunks.append(_chunk_of_index(data[at : at + length]))
            elif opcode == mcap.STATISTICS:
                survey.declared, survey.span_ns = (
                    _statistics(data, at, length),
                    struct.unpack_from("<QQ", data, at + 26),
                )
            at += length
    except (struct.error, UnicodeDecodeError):
        return None
    # A summary must have channels and counts, and chunk indices if the file has chunks.
    if not survey.channels or survey.declared is None:
        return None
    is_complete = bool(survey.chunks) or _CHUNK_PATTERN.search(data[: min(len(data), 1 << 20)]) is None
    survey.chunks.sort(key=lambda chunk: chunk.offset)
    return survey if is_complete else None


def _chunk_of_index(record: bytes) -> _Chunk:
    first_ns, last_ns, offset, length, size = struct.unpack_from("<QQQQI", record, 0)
    # The chunk index lists the channels of a chunk without counts: -1 stands for "some".
    counts = {struct.unpack_from("<HQ", record, 36 + at)[0]: 0 for at in range(0, min(size, len(record) - 36), 10)}
    return _Chunk(offset, length, (first_ns, last_ns), counts or None)


def _is_chunk_at(data: mmap.mmap, chunk: _Chunk) -> bool:
    if chunk.offset + chunk.num_bytes > len(data) or chunk.num_bytes < mcap.HEAD.size + 40:
        return False
    opcode, length = mcap.HEAD.unpack_from(data, chunk.offset)
    if opcode != mcap.CHUNK_OP or length + mcap.HEAD.size != chunk.num_bytes:
        return False
    if chunk.counts:
        at = chunk.offset + chunk.num_bytes
        for _ in range(len(chunk.counts)):
            if at + mcap.HEAD.size + 6 > len(data):
                break
            opcode, length = mcap.HEAD.unpack_from(data, at)
            channel, size = struct.unpack_from("<HI", data, at + mcap.HEAD.size)
            if opcode != mcap.INDEX or channel not in chunk.counts or size + 6 != length:
                break
            chunk.counts[channel] = size // 16
            at += mcap.HEAD.size + length
    return True


def _next_record(data: mmap.mmap, start: int) -> int:
    # In a file with chunks only a chunk is valid: a damaged chunk may hold what looks like a message.
    end, is_chunked = len(data), _CHUNK_PATTERN.search(data) is not None
    pattern = _CHUNK_PATTERN if is_chunked else _RECORD_PATTERN
    for match in pattern.finditer(data, start):
        at = match.start()
        if _is_chain(data, at, 1 if is_chunked else 3):
            return at
    # No chunk follows: the summary, found from the footer, may still hold channels.
    tail = end - len(mcap.MAGIC) - _FOOTER_BYTES
    if tail > start and data[-len(mcap.MAGIC) :] == mcap.MAGIC:
        (summary,) = struct.unpack_from("<Q", data, tail + mcap.HEAD.size)
        if start <= summary < tail and _is_chain(data, summary, 2):
            return int(summary)
    return end


def _is_chain(data: mmap.mmap, at: int, links: int) -> bool:
    for _ in range(links):
        if at + mcap.HEAD.size > len(data):
            return at == len(data)
        opcode, length = mcap.HEAD.unpack_from(data, at)
        if not mcap.is_record(opcode, length, len(data) - at - mcap.HEAD.size) or opcode >= 0x80:
            return False
        if opcode == mcap.CHUNK_OP:
            _, _, _, _, name_bytes = mcap.CHUNK.unpack_from(data, at + mcap.HEAD.size)
            if name_bytes > 4:
                return False
            (packed,) = struct.unpack_from("<Q", data, at + mcap.HEAD.size + mcap.CHUNK.size + name_bytes)
            if packed != length - mcap.CHUNK.size - name_bytes - 8:
                return False
        at += mcap.HEAD.size + length
    return True


def _statistics(data: mmap.mmap, at: int, length: int) -> dict[int, int] | None:
    (size,) = struct.unpack_from("<I", data, at + 42)
    if size > length - 46:
        return None
    return dict(struct.iter_unpack("<HQ", data[at + 46 : at + 46 + size // 10 * 10]))
