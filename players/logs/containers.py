"""Topics and raw messages, as all recorded logs have them.

A message type is compiled from the definition in the log, or from ROS 2's own if the log has none.
A definition that cannot be parsed makes only its topic unreadable.
"""

import hashlib
import struct
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol

from players.logs.log_damage import Flaws

DefinitionFormat = Literal["msg", "idl", "protobuf", "jsonschema", "none"]
_SAMPLE_BYTES, _EARLY_MESSAGES = 1 << 20, 150
_VIDEOS = {
    "foxglove_msgs/msg/CompressedVideo": "time timestamp\nstring frame_id\nuint8[] data\nstring format",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket": "std_msgs/Header header\nint32 width\nint32 height\n"
    "string encoding\nuint64 pts\nuint8 flags\nbool is_bigendian\nuint8[] data",
}
Wire = Literal["cdr", "ros1", "protobuf", "json", "other"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Topic:
    """A topic of a log; `type_name` is package/msg/Name for ROS 1 and ROS 2, `num_messages` is None if unknown."""

    name: str
    type_name: str
    num_messages: int | None = None
    wire: Wire = "cdr"
    definition_format: DefinitionFormat = "none"
    definition: str = ""
    #: A type from outside ROS; `type_name` is then its equivalent in ROS.
    foreign_type: str = ""


class LogMessage(NamedTuple):
    """A serialised message; `log_ns` is the time at which it was received, which may be much later than its stamp."""

    topic: str
    log_ns: int
    data: Any


class UnreadableMessageError(Exception):
    """A message that cannot be deserialised; the reader counts it."""


class Log(Protocol):
    """A container of messages."""

    @property
    def path(self) -> Path | str:
        """The file, the folder, or the address."""

    @property
    def kind(self) -> str:
        """What it is, in words."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All files of the log, in order."""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics, sorted by name."""

    @property
    def flaws(self) -> Flaws:
        """The damage found so far; complete after a pass over all topics."""

    @property
    def checksum(self) -> str:
        """The checksum that protects the messages against altered bytes, in words; "" if there is none."""

    def declared(self) -> Mapping[str, int] | None:
        """Return the declared number of messages of each topic, None if the log declares none."""

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield the messages of some topics, from the beginning, reading each chunk of the file once.

        Unreadable messages are skipped and noted in `flaws`.
        """


def normalized_type(name: str) -> str:
    """Return a message type as package/msg/Name; ROS 1 leaves out the middle, DDS has package::msg::dds_::Name_."""
    if "::" in name or "/dds_/" in name:
        parts = [part for part in name.replace("::", "/").split("/") if part != "dds_"]
        name = "/".join([*parts[:-1], parts[-1].removesuffix("_")])
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


def topic_name(name: str) -> str:
    """Return the name of a topic in ROS for one that was recorded from DDS, where it begins with rt/."""
    return name[2:] if name.startswith("rt/") else name


def merged_topics(topics: Iterable[Topic]) -> tuple[Topic, ...]:
    """Return one topic per name, sorted; several channels or connections of a topic are several publishers of it."""
    by_name: dict[str, Topic] = {}
    for topic in topics:
        known = by_name.get(topic.name)
        if known is None:
            by_name[topic.name] = topic
        elif topic.num_messages is not None and known.num_messages is not None:
            by_name[topic.name] = replace(known, num_messages=known.num_messages + topic.num_messages)
    return tuple(by_name[name] for name in sorted(by_name))


def summed_by(name_of: Callable[[int], str], counts: Mapping[int, int] | None) -> dict[str, int] | None:
    """Return counts by topic from those by channel or connection; None for None."""
    if counts is None:
        return None
    total: Counter[str] = Counter()
    for number, count in counts.items():
        total[name_of(number)] += count
    return dict(total)


def first_messages(log: Log, type_names: Collection[str]) -> dict[str, Any]:
    """Return the first message of each topic of some types, as far as it comes early and can be read."""
    numbers = log.declared() or {}
    topics = {t.name: t for t in log.topics if t.type_name in type_names and numbers.get(t.name, t.num_messages) != 0}
    found: dict[str, Any] = {}
    for count, message in enumerate(log.messages(topics)):
        if message.topic not in found:
            with suppress(UnreadableMessageError):
                found[message.topic] = deserialize(topics[message.topic], message.data)
        if len(found) == len(topics) or count > _EARLY_MESSAGES:
            break
    return found


def deserialize(topic: Topic, data: Any) -> Any:
    """Return the message of raw bytes; arrays in it are read-only views of them.

    Raises `UnreadableMessageError`: the type cannot be compiled, or the bytes do not fit it.
    """
    from rosbags.serde import SerdeError
    from rosbags.typesys import TypesysError

    if topic.wire in ("protobuf", "json") and topic.foreign_type:
        from players.messages.foxglove import decode_foxglove

        try:
            return decode_foxglove(topic.foreign_type, topic.wire, topic.definition, data)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise UnreadableMessageError(f"{topic.name}: {error!r}") from error
    try:
        store = _typestore(topic.type_name, topic.definition_format, topic.definition, topic.wire)
        if topic.wire == "cdr":
            return store.deserialize_cdr(data, topic.type_name)
        if topic.wire == "ros1":
            return store.deserialize_ros1(data, topic.type_name)
    # The generated code raises errors of any kind on damaged bytes.
    except (SerdeError, TypesysError, struct.error, LookupError, ValueError, AssertionError) as error:
        raise UnreadableMessageError(f"{topic.name}: {error!r}") from error
    raise UnreadableMessageError(f"{topic.name}: messages are neither CDR nor ROS 1, nor Foxglove's")


@lru_cache(maxsize=64)
def _typestore(type_name: str, definition_format: DefinitionFormat, definition: str, wire: Wire) -> Any:
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    if definition_format == "none" or not definition.strip():
        return own_types(wire)
    is_msg = definition_format == "msg"
    types = get_types_from_msg(definition, type_name) if is_msg else get_types_from_idl(definition)
    # Some writers leave out the definitions of the types of fields.
    needed = [name for _, fields in types.values() for name in _types_of(fields)]
    while needed:
        name = needed.pop()
        if name not in types and name in own_types(wire).fielddefs:
            types[name] = own_types(wire).fielddefs[name]
            needed += _types_of(types[name][1])
    store = get_typestore(Stores.EMPTY)
    store.register(types)
    return store


@lru_cache(maxsize=2)
def own_types(wire: Wire) -> Any:
    """Return the store of ROS 1's own types, or of ROS 2's."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if wire == "ros1" else Stores.ROS2_HUMBLE)
    if wire == "ros1":
        for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
            store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    for name, definition in _VIDEOS.items():
        store.register(get_types_from_msg(definition, name))
    return store


def _types_of(fields: Any) -> list[str]:
    # The names of message types among the fields, also of those in arrays and sequences.
    named = []
    for _, (kind, detail) in fields:
        while kind.name in ("ARRAY", "SEQUENCE"):
            kind, detail = detail[0]
        if kind.name == "NAME":
            named.append(detail)
    return named


def files_identity(files: Sequence[Path], sampled: Sequence[Path] | None = None) -> str:
    """Return the sha256 over name and size of all files, and the first and last MiB of the `sampled` ones (or of all).

    The folder is not included, so that a log keeps its identity when it is moved.
    """
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.name}\0{file.stat().st_size}\0".encode())
    for file in files if sampled is None else sampled:
        with file.open("rb") as stream:
            digest.update(stream.read(_SAMPLE_BYTES))
            stream.seek(max(_SAMPLE_BYTES, file.stat().st_size - _SAMPLE_BYTES))
            digest.update(stream.read(_SAMPLE_BYTES))
    return digest.hexdigest()
