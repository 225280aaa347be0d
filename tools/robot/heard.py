"""What a robot is told by whoever maps it: messages by topic, and the answers to its goals."""

import threading
import time
from collections import Counter
from dataclasses import dataclass, field

from hickory_stream.sinks.publish_sink import (
    MAP_TOPIC,
    MARKERS_TOPIC,
    OBJECTS_TOPIC,
    PLAN_TOPIC,
    TF_TOPIC,
    UPDATES_TOPIC,
)

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
