"""Record types of MCAP, in a file or a stream: schemas, channels and chunks."""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

from players.logs.containers import DefinitionFormat, Topic, Wire, normalized_type, topic_name
from players.logs.decompression import UnpackError, unpack
from players.messages.foxglove import ROS_TYPES

MAGIC = b"\x89MCAP0\r\n"
_WIRES: dict[str, Wire] = {"cdr": "cdr", "ros1": "ros1", "protobuf": "protobuf", "json": "json"}
_FORMATS: dict[str, DefinitionFormat] = {
    **{"ros2msg": "msg", "ros1msg": "msg", "ros2idl": "idl"},
    **{"protobuf": "protobuf", "jsonschema": "jsonschema"},
}

HEAD = struct.Struct("<BQ")
MESSAGE = struct.Struct("<HIQQ")
CHUNK = struct.Struct("<QQQII")
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE_OP, CHUNK_OP, INDEX = 1, 2, 3, 4, 5, 6, 7
CHUNK_INDEX, STATISTICS, DATA_END = 8, 0x0B, 0x0F
# The minimum length of a record of each type; a shorter one is invalid.
_LEAST_BYTES = dict(enumerate((8, 20, 14, 16, 22, 40, 6, 56, 36, 32, 46, 8, 20, 17, 4), start=1))


@dataclass(slots=True)
class Described:
    """The descriptions of messages: (name, encoding, definition) of schemas, (schema, topic, encoding) of channels."""

    schemas: dict[int, tuple[str, str, bytes]] = field(default_factory=dict)
    channels: dict[int, tuple[int, str, str]] = field(default_factory=dict)


def topic_of(described: Described, channel: int, num_messages: int | None) -> Topic:
    """Return the topic of a channel."""
    schema_id, name, encoding = described.channels[channel]
    return make_topic(name, encoding, *described.schemas.get(schema_id, ("", "", b"")), num_messages)


def make_topic(
    name: str, encoding: str, type_name: str, schema_encoding: str, definition: bytes, num_messages: int | None
) -> Topic:
    """Return the topic of a channel and its schema."""
    return Topic(
        name=name,
        type_name=ROS_TYPES.get(type_name, normalized_type(type_name)),
        foreign_type=type_name if type_name in ROS_TYPES else "",
        num_messages=num_messages,
        wire=_WIRES.get(encoding, "other"),
        definition_format=_FORMATS.get(schema_encoding, "none"),
        # Descriptors of protobuf are bytes, stored as Latin-1 text.
        definition=definition.decode("latin-1" if schema_encoding == "protobuf" else "utf-8", errors="replace"),
    )


def schema_of(topic: Topic) -> tuple[str, str, bytes]:
    """Return name, encoding and definition of a topic's type; the definition is ROS 2's own if the log has none."""
    encodings = {"msg": "ros2msg", "idl": "ros2idl", "protobuf": "protobuf", "jsonschema": "jsonschema", "none": ""}
    encoding, definition = encodings[topic.definition_format], topic.definition
    if topic.wire == "cdr" and not definition.strip():
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        if topic.type_name in store.types:
            encoding, definition = "ros2msg", store.generate_msgdef(topic.type_name, ros_version=2)[0]
    data = definition.encode("latin-1" if topic.definition_format == "protobuf" else "utf-8")
    return topic.foreign_type or topic.type_name, encoding, data


def learn(described: Described, opcode: int, record: bytes) -> None:
    """Add a schema or a channel; one that does not parse is left out, so that its messages have no known topic."""
    try:
        (number,) = struct.unpack_from("<H", record, 0)
        if opcode == SCHEMA:
            name, at = _string(record, 2)
            encoding, at = _string(record, at)
            (size,) = struct.unpack_from("<I", record, at)
            described.schemas[number] = (name, encoding, record[at + 4 : at + 4 + size])
        else:
            (schema,) = struct.unpack_from("<H", record, 2)
            topic, at = _string(record, 4)
            encoding, _ = _string(record, at)
            described.channels[number] = (schema, topic_name(topic), encoding)
    except (struct.error, UnicodeDecodeError, ValueError):
        pass


def unpacked_chunk(data: Any, at: int, end: int) -> Any:
    """Return the records of a chunk whose content lies in `data` from `at` to `end`.

    Raises `UnpackError`: it is damaged.
    """
    _, _, size, crc, name_bytes = CHUNK.unpack_from(data, at)
    at += CHUNK.size
    if name_bytes > 16 or at + name_bytes + 8 > end:
        raise UnpackError("has a header that does not fit it")
    compression = bytes(data[at : at + name_bytes]).decode("ascii", errors="replace")
    at += name_bytes
    (packed,) = struct.unpack_from("<Q", data, at)
    at += 8
    if packed != end - at:
        raise UnpackError(f"says to hold {packed} bytes and holds {end - at}")
    if compression in ("lz4", "zstd"):
        with memoryview(data) as view, view[at:end] as packed_bytes:
            records = unpack(compression, packed_bytes, size)
    else:
        records = unpack(compression, data[at:end], size)
    if crc and zlib.crc32(records) != crc:
        raise UnpackError("fails its checksum")
    return records


def records_in(chunk: Any) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, place and length of each whole record in an unpacked chunk."""
    at, end = 0, len(chunk)
    while at + HEAD.size <= end:
        opcode, length = HEAD.unpack_from(chunk, at)
        at += HEAD.size
        if length > end - at:
            return
        yield opcode, at, length
        at += length


def is_record(opcode: int, length: int, room: int) -> bool:
    """Return whether a record can have this opcode and length; opcodes from 0x80 on are private."""
    return length <= room and (opcode >= 0x80 or length >= _LEAST_BYTES.get(opcode, room + 1))


def _string(record: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from("<I", record, at)
    if size > len(record) - at - 4:
        raise ValueError("a string that is longer than its record")
    return record[at + 4 : at + 4 + size].decode("utf-8"), at + 4 + size
