"""The messages of a log as a robot publishes them: CDR bytes with their definitions, and when each is due."""
# Replaces the header stamps of serialised (CDR) messages.

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from hickory_stream.errors import RecordingError
from players.logs.containers import Topic
from players.messages.records import HEADER_FIRST, TF
from players.opening import open_container

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


@dataclass(frozen=True, kw_only=True, slots=True)
class Due:
    """A message and when it is due, in nanoseconds since the first one."""

    due_ns: int
    topic: Topic
    data: bytes
    #: its log was played so long before: its stamps are so much later
    later_ns: int = 0

    @property
    def is_latched(self) -> bool:
        """Whether a robot keeps it for those who come late."""
        return self.topic.name.endswith("tf_static")


def prepared(paths: Sequence[Path], *, most_s: float | None = None, loops: int = 1) -> list[Due]:
    """Return the messages of a log in order, `loops` times one after the other with stamps that go on."""
    # Messages of ROS 1 become those of ROS 2; what is latched comes first, as a robot sends it when it starts.
    # Raises RecordingError: there is no log, or nothing in it can be published.
    log = open_container(*paths)
    topics = {topic.name: topic for topic in log.topics if _can_be_published(topic)}
    published = {name: _published(topic) for name, topic in topics.items()}
    first_ns: int | None = None
    found: list[Due] = []
    for message in log.messages(list(topics)):
        first_ns = message.log_ns if first_ns is None else first_ns
        due_ns = max(0, message.log_ns - first_ns)
        if most_s is not None and due_ns > most_s * 1e9:
            break
        topic, data = topics[message.topic], bytes(message.data)
        if topic.wire == "ros1":
            data = bytes(humble().ros1_to_cdr(data, published[message.topic].type_name))
        found.append(Due(due_ns=due_ns, topic=published[message.topic], data=data))
    if not found:
        raise RecordingError(f"{log.path} holds no messages that a robot could publish")
    found.sort(key=lambda due: (not due.is_latched, due.due_ns))
    length_ns = max(due.due_ns for due in found) + 100_000_000
    return [
        replace(due, due_ns=due.due_ns + i * length_ns, later_ns=i * length_ns)
        for i in range(loops)
        for due in found
        if not (i and due.is_latched)
    ]


def _can_be_published(topic: Topic) -> bool:
    known = topic.type_name in (*TF, *humble().types)
    return topic.wire in ("cdr", "protobuf", "json") or (topic.wire == "ros1" and known)


def _published(topic: Topic) -> Topic:
    if topic.wire != "ros1":
        return topic
    type_name = TF[0] if topic.type_name in TF else topic.type_name
    definition = humble().generate_msgdef(type_name, ros_version=2)[0]
    return replace(topic, type_name=type_name, wire="cdr", definition_format="msg", definition=definition)
