"""MCAP files, read with the plain `mcap` reader: checksums verified, messages in the order of the file.

The order of the file rather than of log time: what is late by header stamp is sorted further up, and a file without an
index need not be held in memory to be sorted.
"""

from __future__ import annotations

from typing import IO, TYPE_CHECKING, Any

from hickory_stream.errors import RecordingError
from players.containers import LogMessage, Topic, merged_topics, normalized_type

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator
    from pathlib import Path

    from players.containers import DefinitionFormat, Wire

_MAGIC = b"\x89MCAP0\r\n"
_RECORD_HEADER_BYTES = 9
_WIRES: dict[str, Wire] = {"cdr": "cdr", "ros1": "ros1"}
_FORMATS: dict[str, DefinitionFormat] = {"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl"}


class McapLog:
    """A `Log` in one MCAP file."""

    kind = "MCAP"

    def __init__(self, path: Path) -> None:
        """Read the summary; a file without one is scanned once for its channels.

        Raises:
            RecordingError: the file is truncated or damaged.
        """
        self.path = path
        self.files = (path,)
        self._chunks: list[Any] = []
        self._channels: dict[int, str] = {}
        self.topics = self._read_topics()

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics in the order of the file.

        Raises:
            RecordingError: a chunk is damaged.
        """
        with self.path.open("rb") as stream:
            try:
                yield from self._indexed(stream, set(topics)) if self._chunks else _streamed(stream, set(topics))
            except _damage() as error:
                raise self._damaged(error) from error

    def _indexed(self, stream: IO[bytes], topics: set[str]) -> Iterator[LogMessage]:
        """Yield messages chunk by chunk; chunks without any of the topics are not read.

        The package's own reader, when not asked to sort, holds all chunks in memory before its first message.
        """
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk, Message
        from mcap.stream_reader import breakup_chunk

        wanted = {number: name for number, name in self._channels.items() if name in topics}
        for index in self._chunks:
            if index.message_index_offsets and not wanted.keys() & index.message_index_offsets.keys():
                continue
            stream.seek(index.chunk_start_offset + _RECORD_HEADER_BYTES)
            for record in breakup_chunk(Chunk.read(ReadDataStream(stream)), validate_crc=True):
                if isinstance(record, Message) and record.channel_id in wanted:
                    yield LogMessage(wanted[record.channel_id], record.log_time, record.data)

    def _read_topics(self) -> tuple[Topic, ...]:
        """Return the topics; keeps channels and chunk indices for reading."""
        from mcap.reader import SeekingReader

        with self.path.open("rb") as stream:
            try:
                summary = SeekingReader(stream).get_summary()
                if summary is None or not summary.channels:
                    stream.seek(0)
                    return _scan(stream)
            except _damage() as error:
                raise self._damaged(error) from error
        counts = summary.statistics.channel_message_counts if summary.statistics else None
        topics = [
            _topic(
                channel,
                summary.schemas.get(channel.schema_id),
                counts.get(channel.id, 0) if counts is not None else None,
            )
            for channel in summary.channels.values()
        ]
        self._channels = {channel.id: channel.topic for channel in summary.channels.values()}
        self._chunks = sorted(summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
        return merged_topics(topics)

    def _damaged(self, error: Exception) -> RecordingError:
        """Return the error for bytes that are no MCAP; a file that was cut off lacks the magic at its end."""
        with self.path.open("rb") as stream:
            stream.seek(max(0, self.path.stat().st_size - len(_MAGIC)))
            is_cut_off = stream.read() != _MAGIC
        found = "is cut off: its end is missing" if is_cut_off else f"is damaged ({str(error) or type(error).__name__})"
        return RecordingError(f"{self.path} {found}; `mcap recover` saves what is whole")


def _streamed(stream: IO[bytes], topics: set[str]) -> Iterator[LogMessage]:
    """Yield the messages of a file without chunk indices, reading all of it."""
    from mcap.reader import NonSeekingReader

    reader = NonSeekingReader(stream, validate_crcs=True)
    for _, channel, message in reader.iter_messages(topics=topics, log_time_order=False):
        yield LogMessage(channel.topic, message.log_time, message.data)


def _scan(stream: IO[bytes]) -> tuple[Topic, ...]:
    """Return the topics of a file without a summary, by reading all of it."""
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    schemas: dict[int, Any] = {}
    channels: dict[int, Any] = {}
    counts: dict[int, int] = {}
    for record in StreamReader(stream, validate_crcs=True).records:
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel):
            channels[record.id] = record
        elif isinstance(record, Message):
            counts[record.channel_id] = counts.get(record.channel_id, 0) + 1
    return merged_topics([_topic(c, schemas.get(c.schema_id), counts.get(c.id, 0)) for c in channels.values()])


def _damage() -> tuple[type[Exception], ...]:
    """Return what the reader raises on bytes that are no MCAP: its own errors, and those of parsing and unpacking."""
    import struct

    from mcap.exceptions import McapError
    from zstandard import ZstdError

    return (McapError, struct.error, ZstdError, LookupError, ValueError, EOFError, RuntimeError)


def _topic(channel: Any, schema: Any, num_messages: int | None) -> Topic:
    """Return the topic of a channel; without a schema its type has no name."""
    return Topic(
        name=channel.topic,
        type_name=normalized_type(schema.name) if schema else "",
        num_messages=num_messages,
        wire=_WIRES.get(channel.message_encoding, "other"),
        definition_format=_FORMATS.get(schema.encoding, "none") if schema else "none",
        definition=schema.data.decode("utf-8", errors="replace") if schema else "",
    )
