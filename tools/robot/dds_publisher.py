"""A robot whose nodes speak DDS: Cyclone, with the bytes of messages as samples, on the loopback address."""

import threading
import time
from collections.abc import Collection
from typing import Any

from hickory_stream.sinks.publish_sink import GOAL_TOPIC
from hickory_stream.sinks.ros_messages import DETECTIONS, GOAL, GRID, MARKERS, PATH, TRANSFORMS, UPDATE
from players.live.dds_domain import check_installed, participant, qos, settings, taken, topic_of, write
from players.logs.containers import Topic
from tools.robot.link import Sending
from tools.robot.publishers import TOPICS, Heard

_TYPES = dict(zip(TOPICS, (GRID, UPDATE, DETECTIONS, MARKERS, TRANSFORMS, PATH), strict=True))
_LATCHED = (GRID, MARKERS)


class DdsPublisher:
    """Publishes in a domain: all reliable, latched topics transient-local."""

    def __init__(self, domain: int) -> None:
        check_installed()
        self._domain = domain
        self._member: Any = None
        self._held: Any = None
        self._writers: dict[str, Any] = {}
        self._readers: dict[str, Any] = {}
        self._latched: set[str] = set()
        self._is_over = threading.Event()
        self._thread: threading.Thread | None = None
        self.heard = Heard()

    def connect(self, topics: Collection[Topic]) -> None:
        from cyclonedds.pub import DataWriter
        from cyclonedds.sub import DataReader

        self._held, self._member = participant(self._domain, settings("127.0.0.1", ("127.0.0.1",)))
        for topic in topics:
            is_latched = topic.name.endswith("tf_static")
            if is_latched:
                self._latched.add(topic.name)
            kind = qos(is_reliable=True, is_latched=is_latched)
            made = topic_of(self._member, topic.name, topic.type_name)
            self._writers[topic.name] = DataWriter(self._member, made, qos=kind)
        self._writers[GOAL_TOPIC] = DataWriter(
            self._member, topic_of(self._member, GOAL_TOPIC, GOAL), qos=qos(is_reliable=True, is_latched=False)
        )
        for name, type_name in _TYPES.items():
            kind = qos(is_reliable=True, is_latched=type_name in _LATCHED)
            self._readers[name] = DataReader(self._member, topic_of(self._member, name, type_name), qos=kind)
        self._is_over.clear()
        self._thread = threading.Thread(target=self._hear, daemon=True)
        self._thread.start()

    def disconnect(self) -> None:
        self._is_over.set()
        if self._thread is not None:
            self._thread.join(5.0)
        self._writers.clear()
        self._readers.clear()
        self._member = self._held = None

    def is_heard(self, name: str) -> bool:
        """Return whether somebody subscribes; what is kept reaches those that come later, too."""
        return name in self._latched or bool(self._writers[name].get_matched_subscriptions())

    def send(self, sending: Sending) -> None:
        write(self._writers[sending.due.topic.name], sending.data)

    def ask(self, data: bytes) -> None:
        self.heard.ask()
        write(self._writers[GOAL_TOPIC], data)

    def _hear(self) -> None:
        while not self._is_over.is_set():
            for name, reader in self._readers.items():
                for data in taken(reader):
                    self.heard.take(name, data)
            time.sleep(0.005)
