"""Arriving messages as a log, read by the code that reads files.

While it is opened, messages are kept so that it can be read repeatedly: all small ones and the newest images.
After `begin`, each message is passed on once and forgotten.
"""

import time
from collections import Counter, deque
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path

from players.live.inbox import Inbox
from players.live.transport import LiveSource
from players.logs.containers import LogMessage, Topic
from players.logs.log_damage import Flaws
from players.messages.header_stamp import serialized_stamp_ns
from players.messages.records import CAMERA_INFO, COMPRESSED_IMAGE, IMAGE, POSE_TYPES, TF, VIDEOS

_IMAGES = (IMAGE, COMPRESSED_IMAGE, *VIDEOS)
_KEPT_IMAGE_BYTES, _KEPT_SMALL_BYTES = 96 << 20, 64 << 20
_POLL_S = 0.2


class LiveLog:
    """A `Log` of an inbox; it ends with the route, after `end`, or after `most_s` of mapping.

    `loses_nothing`: the route waits (a recording), so all messages are kept while the log is opened.
    """

    files: tuple[Path, ...] = ()
    checksum = ""

    def __init__(
        self, source: LiveSource, inbox: Inbox, *, most_s: float | None = None, loses_nothing: bool = False
    ) -> None:
        self.path = source.uri
        self.kind = source.kind
        self.flaws = Flaws()
        self.clock_offset = ClockOffset()
        self.inbox = inbox
        self.roles: dict[str, str] = {}
        """Roles of the requested topics, by name."""
        self.hidden: frozenset[str] = frozenset()
        """Topics of other robots, which a reader of the log does not see."""
        self._most_s = most_s
        self._loses_nothing = loses_nothing
        self._wanted: frozenset[str] | None = None
        self._kept: deque[LogMessage] = deque()
        self._kept_bytes = {True: 0, False: 0}
        self._pass_ends_s = 0.0
        self._began_s: float | None = None
        self._is_ended = False

    @property
    def topics(self) -> tuple[Topic, ...]:
        """The topics announced so far."""
        return tuple(topic for topic in self.inbox.topics if topic.name not in self.hidden)

    def declared(self) -> Mapping[str, int]:
        """Return the number of received messages of each topic."""
        found = self.inbox.arrivals
        topics = self.inbox.topics
        return {topic.name: found[topic.name].num_received if topic.name in found else 0 for topic in topics}

    def left(self) -> Counter[str]:
        """Return the number of received messages of each topic that were not passed on yet."""
        return self.inbox.waiting() + Counter(message.topic for message in self._kept)

    def want(self, names: Collection[str]) -> None:
        """Keep the images of these topics only from now on; small messages are always kept."""
        self._wanted = frozenset(names)

    def attempt(self, seconds: float) -> None:
        """Begin an attempt at opening: `messages` waits this long for more."""
        self._pass_ends_s = time.monotonic() + seconds

    def idle(self, seconds: float) -> None:
        """Receive and keep messages for a while."""
        ends_s = time.monotonic() + seconds
        while not self._is_ended and not self.inbox.is_over and (left_s := ends_s - time.monotonic()) > 0:
            self._keep(self._taken(min(left_s, _POLL_S)))

    def begin(self) -> None:
        """End the opening: messages are passed on once from now on."""
        self._began_s = time.monotonic()

    def end(self) -> None:
        """Accept no more messages, and wake a waiting reader."""
        self._is_ended = True
        self.inbox.close()

    def messages(self, topics: Collection[str]) -> Iterator[LogMessage]:
        """Yield kept messages, then arriving ones until the attempt at opening ends, or after `begin` to the end."""
        wanted = set(topics)
        if self._began_s is not None:
            yield from self._running(wanted)
            return
        for message in list(self._kept):
            if message.topic in wanted:
                yield message
        while not self._is_ended and not self.inbox.is_over and time.monotonic() < self._pass_ends_s:
            kept = self._keep(self._taken(_POLL_S))
            if kept is not None and kept.topic in wanted:
                yield kept

    def _running(self, wanted: set[str]) -> Iterator[LogMessage]:
        self._wanted = frozenset(wanted)
        try:
            while not self._is_ended and self._kept:
                message = self._kept.popleft()
                if message.topic in wanted:
                    yield message
            while not self._is_ended and not self.inbox.is_over and not self._is_long_enough():
                taken = self.inbox.take(_POLL_S)
                if taken is not None:
                    self._note(taken)
                if taken is not None and taken.topic in wanted:
                    yield taken
        finally:
            self.inbox.close()

    def _is_long_enough(self) -> bool:
        assert self._began_s is not None
        return self._most_s is not None and time.monotonic() - self._began_s >= self._most_s

    def _taken(self, timeout_s: float) -> LogMessage | None:
        if self._loses_nothing and self._kept_bytes[True] > _KEPT_IMAGE_BYTES // 2:
            time.sleep(timeout_s)
            return None
        return self.inbox.take(timeout_s)

    def _keep(self, message: LogMessage | None) -> LogMessage | None:
        if message is None:
            return None
        topic = self._note(message)
        is_image = topic.type_name in _IMAGES
        is_chosen = self._wanted is None or message.topic in self._wanted
        if not (is_chosen if is_image else topic.type_name in (*TF, *POSE_TYPES, CAMERA_INFO)):
            return None
        self._kept.append(message)
        self._kept_bytes[is_image] += len(message.data)
        if self._kept_bytes[is_image] > (_KEPT_IMAGE_BYTES if is_image else _KEPT_SMALL_BYTES):
            self._forget(is_image)
        return message

    def _forget(self, is_image: bool) -> None:
        # A long opening must not fill the memory.
        types = {topic.name: topic.type_name in _IMAGES for topic in self.inbox.topics}
        surplus = self._kept_bytes[is_image] // 2
        rest: deque[LogMessage] = deque()
        for message in self._kept:
            if surplus > 0 and types[message.topic] is is_image and not message.topic.endswith("tf_static"):
                surplus -= len(message.data)
                self._kept_bytes[is_image] -= len(message.data)
                self.inbox.drop(message, "before_opening")
            else:
                rest.append(message)
        self._kept = rest

    def _note(self, message: LogMessage) -> Topic:
        topic = self.inbox.topic(message.topic)
        if topic.type_name in _IMAGES and not topic.foreign_type:
            stamp_ns = serialized_stamp_ns(topic, message.data)
            if stamp_ns is not None:
                self.clock_offset.add(message.log_ns, stamp_ns)
        return topic


# Offset between a robot's clock and ours, from the arrival of its messages.
# A message never arrives before it was made: the least difference of the last minute is offset plus shortest delay.
# Stamps stay the robot's; the offset is only shown.
_WINDOW_NS = 60_000_000_000
_STEP_NS = 1_000_000_000
_CONFIRMED = 3


class ClockOffset:
    """Difference between arrival and stamp; a lasting step of over a second means that a clock was set."""

    def __init__(self) -> None:
        self.num_steps = 0
        # The least differences of the window, each later than the one before and greater: the first is the least.
        self._least: deque[tuple[int, int]] = deque()
        self._odd: list[int] = []

    @property
    def offset_ns(self) -> int | None:
        """Our clock less the robot's, and the shortest delay; None before the first stamp."""
        return self._least[0][1] if self._least else None

    def add(self, arrival_ns: int, stamp_ns: int) -> None:
        """Add a message; stamps that were never set are ignored."""
        if stamp_ns <= 0:
            return
        difference_ns = arrival_ns - stamp_ns
        offset_ns = self.offset_ns
        if offset_ns is not None and abs(difference_ns - self._least[-1][1]) > _STEP_NS:
            self._odd = [kept for kept in self._odd if abs(kept - difference_ns) <= _STEP_NS] + [difference_ns]
            # A delay that grows is no step of the clock: a link that is behind lets go of it again.
            if len(self._odd) < _CONFIRMED or 0 < difference_ns - self._least[0][1] < _WINDOW_NS:
                return
            self._least.clear()
            self.num_steps += 1
        self._odd.clear()
        while self._least and self._least[-1][1] >= difference_ns:
            self._least.pop()
        self._least.append((arrival_ns, difference_ns))
        while arrival_ns - self._least[0][0] > _WINDOW_NS:
            self._least.popleft()
