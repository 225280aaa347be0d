"""Live logging to a viewer: a bounded queue and a daemon thread that empties it.

Rerun's own queue grows to 300 MB for a stalled viewer and then blocks for ever. This thread flushes each entry before
the next, so that entries wait, and are dropped, in the queue here.
"""

import logging
import socket
import threading
import time
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import rerun as rr

from hickory_stream.sinks.rerun.items import LogItem, Moment, Span, Weight, emit, new_stream
from hickory_stream.sinks.rerun.viewer import host_and_port

_POLL_S = 0.2
_PATIENCE_S = 2.0

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Entry:
    """Items of one moment: one heavy item, or all light ones."""

    moment: Moment
    items: tuple[LogItem, ...]
    weight: Weight


class LiveQueue:
    """A bounded queue that drops the oldest heavy entry first.

    It keeps the last items of each lasting entity: dropped ones are sent when the queue is empty, all of them to a late
    viewer. The map bounds that memory.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._entries: deque[Entry] = deque()
        self._latest: dict[tuple[str, str], Entry] = {}
        self._missing: set[tuple[str, str]] = set()
        self._changed = threading.Condition()
        self._dropped: Counter[Weight] = Counter()

    def put(self, moment: Moment, items: list[LogItem]) -> None:
        """Queue the items of a moment; never waits."""
        heavy = [Entry(moment=moment, items=(i,), weight=i.weight) for i in items if i.weight is Weight.HEAVY]
        light = tuple(i for i in items if i.weight is Weight.LIGHT)
        with self._changed:
            for entry in [Entry(moment=moment, items=light, weight=Weight.LIGHT), *heavy]:
                self._remember(entry)
                self._entries.append(entry)
                if len(self._entries) > self._capacity:
                    self._drop_one()
            self._changed.notify()

    def take(self, timeout_s: float) -> Entry | None:
        """Return the next entry, else a dropped one that is still missing, else None after the timeout."""
        with self._changed:
            if not self._entries and not self._missing:
                self._changed.wait(timeout_s)
            if self._entries:
                return self._entries.popleft()
            if self._missing:
                key = min(self._missing)
                self._missing.remove(key)
                return self._latest[key]
            return None

    def start_over(self) -> None:
        """Send every lasting item again, for a new viewer."""
        with self._changed:
            self._missing = set(self._latest)

    def dropped(self) -> Mapping[str, int]:
        """Return the number of dropped entries by weight."""
        with self._changed:
            return {weight.name.lower(): self._dropped[weight] for weight in Weight}

    def _remember(self, entry: Entry) -> None:
        for item in entry.items:
            if item.is_clear:
                below = [key for key in self._latest if f"{key[0]}/".startswith(f"{item.path}/")]
                for key in below:
                    del self._latest[key]
                self._missing.difference_update(below)
            if item.span is not Span.MOMENT:
                self._latest[item.key] = Entry(moment=entry.moment, items=(item,), weight=item.weight)
                self._missing.discard(item.key)

    def _drop_one(self) -> None:
        heavy = (i for i, entry in enumerate(self._entries) if entry.weight is Weight.HEAVY)
        index = next(heavy, 0)
        entry = self._entries[index]
        del self._entries[index]
        self._dropped[entry.weight] += 1
        for item in entry.items:
            latest = self._latest.get(item.key)
            if latest is not None and latest.items[0] is item:
                self._missing.add(item.key)


class LiveFeed:
    """Feeds a viewer from its own thread; connects when a viewer listens, and reconnects."""

    def __init__(self, *, url: str, recording_id: str, capacity: int, blueprint: Any) -> None:
        self._url = url
        self._recording_id = recording_id
        self._blueprint = blueprint
        self._queue = LiveQueue(capacity)
        self._ending = threading.Event()
        self._was_told = False
        self._thread = threading.Thread(target=self._run, name="rerun-live", daemon=True)
        self._thread.start()

    def put(self, moment: Moment, items: list[LogItem]) -> None:
        """Queue the items; never waits for the viewer."""
        self._queue.put(moment, items)

    @property
    def dropped(self) -> Mapping[str, int]:
        """Number of dropped entries by weight."""
        return self._queue.dropped()

    def close(self, timeout_s: float) -> None:
        """Send the queue until the timeout, then disconnect."""
        self._ending.set()
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            logger.warning("the viewer at %s did not take everything; dropped: %s", self._url, self.dropped)
            # Rerun's exit handler flushes every stream and would wait for this viewer for ever. The file is closed
            # already, so that nothing is lost.
            rr.unregister_shutdown()

    def _run(self) -> None:
        begun_s = time.monotonic()
        while not self._ending.is_set():
            if not _somebody_listens(self._url):
                self._ending.wait(_POLL_S)
                if self._ending.is_set() or time.monotonic() - begun_s > _PATIENCE_S:
                    self._tell_once()
                continue
            self._was_told = True
            try:
                self._feed()
            except RuntimeError as error:  # the SDK lost the viewer
                logger.warning("the viewer at %s was lost (%s); waiting for it to come back", self._url, error)

    def _tell_once(self) -> None:
        if not self._was_told:
            logger.warning("no viewer answers at %s: nothing is shown until one listens there", self._url)
            self._was_told = True

    def _feed(self) -> None:
        stream = new_stream(self._recording_id)
        stream.connect_grpc(self._url)
        stream.send_blueprint(self._blueprint, make_active=True, make_default=True)
        self._queue.start_over()
        while (entry := self._queue.take(_POLL_S)) is not None or not self._ending.is_set():
            if entry is not None:
                emit(stream, entry.moment, entry.items)
                # Without a timeout on purpose: a stream that is given up while it is stalled blocks, when it is freed,
                # every other stream of the process. A viewer that ends makes this raise.
                stream.flush()
        stream.disconnect()


def _somebody_listens(url: str) -> bool:
    try:
        socket.create_connection(host_and_port(url), timeout=_POLL_S).close()
    except OSError:
        return False
    return True
