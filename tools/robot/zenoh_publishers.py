"""A robot that runs zenoh-bridge-ros2dds or rmw_zenoh: the router, its tokens and its keys, from their documents."""

import struct
from collections.abc import Callable, Collection
from typing import Any

from hickory_stream.base.json_text import dumps
from hickory_stream.sinks.publish_sink import GOAL_TOPIC
from hickory_stream.sinks.ros_messages import GOAL
from players.logs.containers import Topic
from tools.robot.link import Sending
from tools.robot.prepared import humble
from tools.robot.publishers import TOPICS, Heard

_GID = bytes(range(16))


class _Router:
    def __init__(self, address: str) -> None:
        self.address = address
        self.session: Any = None
        self._publishers: dict[str, Any] = {}
        self._latched: set[str] = set()
        self._tokens: list[Any] = []
        self._published: dict[str, int] = {}
        self.heard = Heard()
        self._hearing: list[Any] = []

    def connect(self, topics: Collection[Topic]) -> None:
        import zenoh

        zenoh.init_log_from_env_or("off")
        config = zenoh.Config()
        for key, value in (
            ("mode", "router"),
            ("listen/endpoints", [f"tcp/{self.address}"]),
            ("scouting/multicast/enabled", False),
            ("timestamping/enabled", True),
        ):
            config.insert_json5(key, dumps(value))
        self.session = zenoh.open(config)
        history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
        elsewhere = zenoh.Locality.REMOTE
        for name in TOPICS:
            key, take = self.heard_key(name), _taking(self.heard, name)
            self._hearing.append(
                zenoh.ext.declare_advanced_subscriber(
                    self.session, key, take, history=history, allowed_origin=elsewhere
                )
            )
        for i, topic in enumerate(topics):
            is_latched = topic.name.endswith("tf_static")
            self._tokens.append(self.session.liveliness().declare_token(self.token(topic, i, is_latched=is_latched)))
            key = self.key(topic)
            if is_latched:
                self._latched.add(topic.name)
            if is_latched and self.has_advanced_publishers:
                self._publishers[topic.name] = zenoh.ext.declare_advanced_publisher(
                    self.session, key, allowed_destination=elsewhere, cache=zenoh.ext.CacheConfig(max_samples=10),
                    publisher_detection=True,
                )  # fmt: skip
            else:
                self._publishers[topic.name] = self.session.declare_publisher(
                    key, congestion_control=zenoh.CongestionControl.BLOCK, allowed_destination=elsewhere
                )

    def disconnect(self) -> None:
        self._tokens.clear()
        self._publishers.clear()
        self._hearing.clear()
        self.session.close()

    def is_heard(self, name: str) -> bool:
        return name in self._latched or bool(self._publishers[name].matching_status.matching)

    def send(self, sending: Sending) -> None:
        attachment = self.attachment(sending)
        publisher = self._publishers[sending.due.topic.name]
        if attachment is None:
            publisher.put(sending.data)
        else:
            publisher.put(sending.data, attachment=attachment)

    def ask(self, data: bytes) -> None:
        self.heard.ask()
        self.session.put(self.key(_GOAL), data)

    def heard_key(self, name: str) -> str:
        raise NotImplementedError

    has_advanced_publishers = True

    def token(self, topic: Topic, number: int, *, is_latched: bool) -> str:
        raise NotImplementedError

    def key(self, topic: Topic) -> str:
        raise NotImplementedError

    def attachment(self, sending: Sending) -> bytes | None:
        return None


class ZenohBridge(_Router):
    """zenoh-bridge-ros2dds; `is_old` is one before 1.5, which answers queries for what it keeps."""

    def __init__(self, address: str, *, namespace: str = "", is_old: bool = False) -> None:
        super().__init__(address)
        self._prefix = f"{namespace.strip('/')}/" if namespace.strip("/") else ""
        self.has_advanced_publishers = not is_old
        self._kept: dict[str, list[bytes]] = {}
        self._cache: Any = None

    def connect(self, topics: Collection[Topic]) -> None:
        """Open the bridge; an old one has its publication cache."""
        super().connect(topics)
        if not self.has_advanced_publishers:
            space = f"@/{self.session.zid()}/@ros2_pub_cache"
            self._cache = self.session.declare_queryable(f"{space}/**", self._answer)

    def key(self, topic: Topic) -> str:
        return self._prefix + topic.name.lstrip("/")

    def heard_key(self, name: str) -> str:
        return self._prefix + name.lstrip("/")

    def token(self, topic: Topic, number: int, *, is_latched: bool) -> str:
        """Return key and type with § for slashes, and the QoS: keyless, reliable, durability, keep last."""
        escaped = (self.key(topic).replace("/", "§"), topic.type_name.replace("/", "§"))
        return f"@/{self.session.zid()}/@ros2_lv/MP/{'/'.join(escaped)}/:1:{int(is_latched)}:0,10"

    def send(self, sending: Sending) -> None:
        """Publish a message; an old bridge keeps what is latched."""
        super().send(sending)
        if sending.due.is_latched:
            self._kept.setdefault(self.key(sending.due.topic), []).append(sending.data)

    def _answer(self, query: Any) -> None:
        for key, messages in self._kept.items():
            if str(query.key_expr).endswith(f"@ros2_pub_cache/{key}"):
                for data in messages:
                    query.reply(key, data)


class RmwZenoh(_Router):
    """rmw_zenoh: the type and its hash are in the key, a sequence number is beside every message."""

    def __init__(self, address: str, *, domain: int = 0, namespace: str = "") -> None:
        super().__init__(address)
        self._domain = domain
        self._prefix = f"/{namespace.strip('/')}" if namespace.strip("/") else ""

    def key(self, topic: Topic) -> str:
        """Return domain, topic, DDS type and hash."""
        return f"{self._domain}/{(self._prefix + topic.name).lstrip('/')}/{_dds_type(topic)}/{_hash(topic)}"

    def heard_key(self, name: str) -> str:
        return f"{self._domain}/{(self._prefix + name).lstrip('/')}/*/*"

    def token(self, topic: Topic, number: int, *, is_latched: bool) -> str:
        name = (self._prefix + topic.name).replace("/", "%")
        qos = f":{'1' if is_latched else ''}:,10:,:,:,,"
        place = f"@ros2_lv/{self._domain}/{self.session.zid()}/0/{number}/MP/%/%/robot"
        return f"{place}/{name}/{_dds_type(topic)}/{_hash(topic)}/{qos}"

    def attachment(self, sending: Sending) -> bytes:
        """Return sequence number, time stamp, and the publisher's id behind its length."""
        gid = sending.due.topic.name.encode()[-16:].rjust(16, b"\0")
        return struct.pack("<qqB16s", sending.sequence, sending.at_ns, len(_GID), gid)


def _taking(heard: Heard, name: str) -> Callable[[Any], None]:
    return lambda sample: heard.take(name, sample.payload.to_bytes())


_GOAL = Topic(name=GOAL_TOPIC, type_name=GOAL)


def _dds_type(topic: Topic) -> str:
    package, _, name = topic.type_name.partition("/msg/")
    return f"{package}::msg::dds_::{name}_"


def _hash(topic: Topic) -> str:
    return str(humble().hash_rihs01(topic.type_name))
