"""Replaces the header stamps of serialised (CDR) messages."""

import struct
from functools import cache
from typing import Any

from players.logs.containers import Topic
from players.messages.records import HEADER_FIRST, TF

_STAMP = struct.Struct("<iI")
_SECOND_NS = 1_000_000_000


def restamped(topic: Topic, data: bytes, by_ns: int) -> bytes:
    """Return a CDR message whose header stamps are moved; one without header, or of big-endian bytes, as it is."""
    if by_ns == 0 or topic.wire != "cdr" or not data[1] & 1:
        return data
    if topic.type_name in HEADER_FIRST:
        sec, nanosec = _STAMP.unpack_from(data, 4)
        return data[:4] + _STAMP.pack(*_moved(sec, nanosec, by_ns)) + data[4 + _STAMP.size :]
    if topic.type_name in TF:
        store = humble()
        message = store.deserialize_cdr(data, TF[0])
        for transform in message.transforms:
            stamp = transform.header.stamp
            stamp.sec, stamp.nanosec = _moved(stamp.sec, stamp.nanosec, by_ns)
        return bytes(store.serialize_cdr(message, TF[0]))
    return data


def _moved(sec: int, nanosec: int, by_ns: int) -> tuple[int, int]:
    return divmod(max(0, sec * _SECOND_NS + nanosec + by_ns), _SECOND_NS)


@cache
def humble() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_HUMBLE)
