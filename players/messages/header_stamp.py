"""Header stamps, read from bytes without deserialising a message."""

import struct
from typing import Any

from players.logs.containers import Topic, UnreadableMessageError, deserialize
from players.messages.records import HEADER_FIRST, TF, header_stamp_ns

_LITTLE, _BIG = struct.Struct("<II"), struct.Struct(">II")


def serialized_stamp_ns(topic: Topic, data: Any) -> int | None:
    """Return the stamp of a message whose type begins with a header, or of its first transform; None for others."""
    if topic.foreign_type:
        return _foreign_stamp_ns(topic, data)
    at = 4 if topic.type_name in HEADER_FIRST else 8
    is_known = topic.type_name in HEADER_FIRST or topic.type_name in TF
    if not is_known or len(data) < at + 8 or topic.wire not in ("cdr", "ros1"):
        return None
    # ROS 1 has a sequence number before the stamp; CDR has four bytes for the byte order, of which 1 is little endian.
    layout = _BIG if topic.wire == "cdr" and not data[1] & 1 else _LITTLE
    seconds, nanoseconds = layout.unpack_from(data, at)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _foreign_stamp_ns(topic: Topic, data: Any) -> int | None:
    try:
        message = deserialize(topic, data)
    except UnreadableMessageError:
        return None
    if topic.type_name in TF:
        return header_stamp_ns(message.transforms[0]) if message.transforms else None
    return header_stamp_ns(message)
