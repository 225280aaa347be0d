"""Queue of arrived messages: bounded in bytes, and every dropped message is counted.

Small messages (poses, transforms, calibrations) have a queue of their own; the oldest of each queue is dropped first.
A route that can make its peer wait (a pipe) waits instead.
"""

import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Condition

from players.logs.containers import LogMessage, Topic
from players.messages.records import COMPRESSED_IMAGE, IMAGE, POINT_CLOUD, VIDEOS

MAX_MESSAGE_BYTES = 64 << 20
"""A message that is longer is refused: 4K colour takes 25 MB, raw."""

MAX_TOPICS = 5000
"""So many topics are listed; a robot has some hundred."""

_WINDOW_S = 5
_LARGE = (IMAGE, COMPRESSED_IMAGE, *VIDEOS, POINT_CLOUD)
_LARGE_BYTES, _SMALL_BYTES = 128 << 20, 16 << 20


@dataclass(slots=True)
class Arrivals:
    """The received messages of one topic."""

    num_received: int = 0
    num_bytes: int = 0
    first_ns: int | None = None
    last_ns: int | None = None
    #: Messages by reason that were dropped, refused, or `lost` on the way.
    fates: Counter[str] = field(default_factory=Counter)
    _seconds: dict[int, tuple[int, int]] = field(default_factory=dict)

    def add(self, arrival_ns: int, size: int) -> None:
        """Count a message."""
        self.num_received += 1
        self.num_bytes += size
        self.first_ns = arrival_ns if self.first_ns is None else self.first_ns
        self.last_ns = arrival_ns
        second = arrival_ns // 1_000_000_000
        number, num_bytes = self._seconds.get(second, (0, 0))
        self._seconds[second] = (number + 1, num_bytes + size)
        for old in [key for key in self._seconds if key < second - _WINDOW_S]:
            del self._seconds[old]

    def rate(self, now_ns: int) -> tuple[float, float]:
        """Return messages and bytes per second over the last whole seconds, or since the first message."""
        if self.first_ns is None:
            return 0.0, 0.0
        now = now_ns // 1_000_000_000
        whole = range(max(now - _WINDOW_S, self.first_ns // 1_000_000_000 + 1), now)
        if not whole:
            seconds = max(0.1, (now_ns - self.first_ns) / 1e9)
            return self.num_received / seconds, self.num_bytes / seconds
        found = [self._seconds.get(second, (0, 0)) for second in whole]
        return sum(number for number, _ in found) / len(whole), sum(size for _, size in found) / len(whole)


class ArrivalClock:
    """Nanoseconds since 1970 that never step: wall clock at construction, a steady clock since."""

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def __call__(self) -> int:
        """Return the time now."""
        return time.monotonic_ns() + self._offset_ns


class _Queue:
    def __init__(self, most_bytes: int) -> None:
        self.items: deque[tuple[int, LogMessage]] = deque()
        self.num_bytes = 0
        self.most_bytes = most_bytes

    def has_room(self, size: int) -> bool:
        return not self.items or self.num_bytes + size <= self.most_bytes

    def pop(self) -> LogMessage:
        _, message = self.items.popleft()
        self.num_bytes -= len(message.data)
        return message


class Inbox:
    """Queue between a route's threads and the reading thread; `clock` stamps arrivals.

    `tap` is called with every (topic, message) before anything is dropped.
    """

    def __init__(
        self,
        clock: Callable[[], int] | None = None,
        *,
        large_bytes: int = _LARGE_BYTES,
        small_bytes: int = _SMALL_BYTES,
        max_message_bytes: int = MAX_MESSAGE_BYTES,
        tap: Callable[[Topic, LogMessage], None] | None = None,
    ) -> None:
        self.clock = clock or ArrivalClock()
        self._tap = tap
        self._max_message_bytes = max_message_bytes
        self._changed = Condition()
        self._large, self._small = _Queue(large_bytes), _Queue(small_bytes)
        self._number = 0
        self._topics: dict[str, Topic] = {}
        self._withdrawn: set[str] = set()
        self._announced_ns = self.clock()
        self._end: str | None = None
        self.num_unlisted = 0
        """How many topics were announced beyond `MAX_TOPICS`."""
        self.arrivals: dict[str, Arrivals] = {}

    def announce(self, topic: Topic) -> None:
        """Add a topic; of two types under one name the first one holds."""
        with self._changed:
            self._withdrawn.discard(topic.name)
            if topic.name in self._topics:
                return
            if len(self._topics) >= MAX_TOPICS:
                self.num_unlisted += 1
                return
            self._topics[topic.name] = topic
            self._announced_ns = self.clock()
            self._changed.notify_all()

    def withdraw(self, name: str) -> None:
        """Note that a topic has no publisher any more."""
        with self._changed:
            if name in self._topics:
                self._withdrawn.add(name)

    def put(self, name: str, data: bytes | memoryview, *, waits: bool = False) -> None:
        """Add a message of an announced topic; without room, drop the oldest, or wait if `waits`."""
        with self._changed:
            topic = self._topics.get(name)
            if topic is None or self._end is not None:
                return
            arrived = self._arrived(name)
            message = LogMessage(name, self.clock(), data)
            arrived.add(message.log_ns, len(data))
            if len(data) > self._max_message_bytes:
                arrived.fates["too_large"] += 1
                return
        if self._tap is not None:
            self._tap(topic, message)
        with self._changed:
            queue = self._large if topic.type_name in _LARGE else self._small
            if waits:
                self._changed.wait_for(lambda: queue.has_room(len(data)) or self._end is not None)
            while not queue.has_room(len(data)):
                self._arrived(queue.pop().topic).fates["queue_full"] += 1
            self._number += 1
            queue.items.append((self._number, message))
            queue.num_bytes += len(data)
            self._changed.notify_all()

    def refuse(self, name: str, fate: str) -> None:
        """Count a message that cannot be used, e.g. of another type than its topic."""
        with self._changed:
            if self._end is None and name in self._topics:
                arrived = self._arrived(name)
                arrived.add(self.clock(), 0)
                arrived.fates[fate] += 1

    def lost(self, name: str, number: int) -> None:
        """Count messages that were sent and never came."""
        with self._changed:
            if self._end is None and name in self._topics:
                self._arrived(name).fates["lost"] += number

    def found(self, name: str) -> None:
        """Uncount a lost message that came late."""
        with self._changed:
            arrived = self._arrived(name)
            if self._end is None and arrived.fates["lost"]:
                arrived.fates["lost"] -= 1

    def close(self, reason: str = "") -> None:
        """Accept no more messages; `reason` names the fault, for people."""
        with self._changed:
            self._end = self._end if self._end is not None else reason
            self._changed.notify_all()

    def take(self, timeout_s: float) -> LogMessage | None:
        """Return the oldest message; None after the timeout, or at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._large.items or self._small.items or self._end is not None, timeout_s)
            queues = [queue for queue in (self._large, self._small) if queue.items]
            if not queues:
                return None
            message = min(queues, key=lambda queue: queue.items[0][0]).pop()
            self._changed.notify_all()
            return message

    @property
    def is_over(self) -> bool:
        """Whether the queue is closed and empty."""
        with self._changed:
            return self._end is not None and not self._large.items and not self._small.items

    @property
    def is_closed(self) -> bool:
        """Whether no more messages will come; the queue may hold some."""
        return self._end is not None

    @property
    def end_reason(self) -> str:
        """The fault that ended the stream, "" without one."""
        return self._end or ""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """Announced topics by name, withdrawn ones included, since they may come back."""
        with self._changed:
            return tuple(self._topics[name] for name in sorted(self._topics))

    def topic(self, name: str) -> Topic:
        """Return an announced topic."""
        return self._topics[name]

    def withdrawn(self) -> frozenset[str]:
        """Return the topics without a publisher."""
        with self._changed:
            return frozenset(self._withdrawn)

    def is_quiet(self, for_s: float) -> bool:
        """Return whether no new topic was announced for some time."""
        with self._changed:
            return self.clock() - self._announced_ns >= for_s * 1e9

    def waiting(self) -> Counter[str]:
        """Return the number of queued messages by topic."""
        with self._changed:
            return Counter(message.topic for queue in (self._large, self._small) for _, message in queue.items)

    def drop(self, message: LogMessage, fate: str) -> None:
        """Count a message that was taken and not passed on."""
        with self._changed:
            self._arrived(message.topic).fates[fate] += 1

    def _arrived(self, name: str) -> Arrivals:
        return self.arrivals.setdefault(name, Arrivals())
