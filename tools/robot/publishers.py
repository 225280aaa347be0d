"""How a robot publishes: what every way has in common, and the stream of an MCAP writer."""
# What a robot is told by whoever maps it: messages by topic, and the answers to its goals.

import os
import threading
import time
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from hickory_stream.sinks.publish_sink import (
    MAP_TOPIC,
    MARKERS_TOPIC,
    OBJECTS_TOPIC,
    PLAN_TOPIC,
    TF_TOPIC,
    UPDATES_TOPIC,
)
from players.logs.containers import Topic
from players.logs.mcap_records import schema_of
from tools.robot.link import Sending

TOPICS = (MAP_TOPIC, UPDATES_TOPIC, OBJECTS_TOPIC, MARKERS_TOPIC, TF_TOPIC, PLAN_TOPIC)


@dataclass(slots=True)
class Heard:
    """Counts what comes, keeps the last message of each topic, and measures from a goal to its answer."""

    counts: Counter[str] = field(default_factory=Counter)
    last: dict[str, bytes] = field(default_factory=dict)
    round_trips_s: list[float] = field(default_factory=list)
    asked_s: float | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)

    def take(self, name: str, data: bytes) -> None:
        now_s = time.monotonic()
        with self.lock:
            self.counts[name] += 1
            self.last[name] = data
            if name == PLAN_TOPIC and self.asked_s is not None:
                self.round_trips_s.append(now_s - self.asked_s)
                self.asked_s = None

    def ask(self) -> None:
        """Note that a goal is being sent."""
        with self.lock:
            self.asked_s = time.monotonic()


class Publisher(Protocol):
    """A way to publish; `connect` and `disconnect` may be called several times."""

    def connect(self, topics: Collection[Topic]) -> None: ...

    def disconnect(self) -> None: ...

    def is_heard(self, name: str) -> bool: ...

    def send(self, sending: Sending) -> None: ...

    @property
    def heard(self) -> Heard:
        """What whoever maps the robot has told it."""
        ...

    def ask(self, data: bytes) -> None:
        """Publish a goal (geometry_msgs/PoseStamped)."""
        ...


class McapPublisher:
    """Writes an MCAP stream into a pipe or a file, message by message."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.heard = Heard()

    def connect(self, topics: Collection[Topic]) -> None:
        """Open the pipe (waits for a reader) and write the channels; a stream has no second beginning."""
        from mcap.writer import Writer

        # A pipe cannot tell where it is, which the writer asks for.
        self._stream = os.fdopen(os.open(self._path, os.O_WRONLY | os.O_CREAT), "wb", buffering=0)
        self._position = 0
        self._writer = Writer(self, use_chunking=False)  # type: ignore[arg-type]
        self._writer.start(profile="ros2")
        self._channels = {}
        for topic in topics:
            schema = self._writer.register_schema(*schema_of(topic))
            self._channels[topic.name] = self._writer.register_channel(topic.name, topic.wire, schema)

    def disconnect(self) -> None:
        self._writer.finish()
        self._stream.close()

    def is_heard(self, name: str) -> bool:
        """Return True: who reads the stream reads everything."""
        return True

    def send(self, sending: Sending) -> None:
        """Write a message under the time at which it is due."""
        channel = self._channels[sending.due.topic.name]
        self._writer.add_message(channel, sending.at_ns, sending.data, sending.at_ns, sending.sequence)

    def ask(self, data: bytes) -> None:
        """Do nothing: a stream has no way back."""

    # What the writer needs of a stream.

    def write(self, data: bytes) -> int:
        view = memoryview(data)
        while view:
            view = view[self._stream.write(view) :]
        self._position += len(data)
        return len(data)

    def tell(self) -> int:
        return self._position

    def flush(self) -> None:
        """Do nothing: nothing is held back."""
