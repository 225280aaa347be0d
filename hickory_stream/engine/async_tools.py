"""Tools for the event loop: threads, channels, loop delay, pacing, and the stop request."""

import asyncio
import gc
import sys
import time
from collections import deque
from collections.abc import Callable, Coroutine, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any, Generic, Literal, TypeVar

T = TypeVar("T")


async def on_thread(executor: ThreadPoolExecutor, function: Callable[..., T], *arguments: object) -> T:
    """Return the result of a function that runs on a thread of an executor."""
    return await asyncio.get_running_loop().run_in_executor(executor, function, *arguments)


@contextmanager
def without_pauses() -> Iterator[None]:
    """Let threads take turns after 0.5 ms instead of 5, and collections of garbage skip all that exists already.

    A mapping thread waits for others some 200 times a keyframe, and the objects of all modules take 80 ms to look at.
    """
    interval_s = sys.getswitchinterval()
    sys.setswitchinterval(0.0005)
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(interval_s)


WhenFull = Literal["wait", "drop_oldest"]


class ChannelClosed(Exception):
    """The channel is closed and empty."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelStatistics:
    """Items in a channel now, its capacity, the largest number so far, and the number of dropped items."""

    length: int
    capacity: int
    peak: int
    dropped: int


class Channel(Generic[T]):
    """A closable channel of `capacity` items between tasks of one loop.

    `when_full`: `send` waits ("wait"), or replaces the oldest item ("drop_oldest").
    """

    def __init__(self, capacity: int, when_full: WhenFull = "wait") -> None:
        if capacity < 1:
            raise ValueError(f"a channel of capacity {capacity}")
        self._items: deque[T] = deque()
        self._capacity = capacity
        self._when_full = when_full
        self._peak = 0
        self._dropped = 0
        self._is_closed = False
        self._changed = asyncio.Condition()

    async def send(self, item: T) -> T | None:
        """Put an item in; return the item that it replaced, or None. Raises `ChannelClosed`."""
        async with self._changed:
            if self._when_full == "wait":
                await self._changed.wait_for(lambda: len(self._items) < self._capacity or self._is_closed)
            if self._is_closed:
                raise ChannelClosed
            dropped = self._items.popleft() if len(self._items) >= self._capacity else None
            self._dropped += dropped is not None
            self._items.append(item)
            self._peak = max(self._peak, len(self._items))
            self._changed.notify_all()
            return dropped

    async def receive(self) -> T:
        """Take the oldest item, waiting for one. Raises `ChannelClosed`."""
        async with self._changed:
            await self._wait_for_items()
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    async def receive_all(self) -> list[T]:
        """Take all items, the oldest first, waiting for at least one. Raises `ChannelClosed`."""
        async with self._changed:
            await self._wait_for_items()
            items = list(self._items)
            self._items.clear()
            self._changed.notify_all()
            return items

    async def close(self) -> None:
        """End the stream; items in the channel can still be taken."""
        async with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def statistics(self) -> ChannelStatistics:
        """Return current and largest number of items."""
        length = len(self._items)
        return ChannelStatistics(length=length, capacity=self._capacity, peak=self._peak, dropped=self._dropped)

    async def _wait_for_items(self) -> None:
        await self._changed.wait_for(lambda: self._items or self._is_closed)
        if not self._items:
            raise ChannelClosed


# Each look wakes the process: every 5 ms, that was most of the processor time of the event loop.
_PERIOD_S = 0.025
_BIN_S = 0.0001
_NUM_BINS = 20_000


class LoopDelay:
    """Histogram of the event loop's delays, in steps of 0.1 ms up to 2 s, measured every 25 ms by `watch`."""

    def __init__(self) -> None:
        self._counts = [0] * (_NUM_BINS + 1)
        self._num = 0
        self._recent_s = 0.0

    async def watch(self) -> None:
        """Measure until cancelled."""
        while True:
            due_s = time.monotonic() + _PERIOD_S
            await asyncio.sleep(_PERIOD_S)
            self.add(time.monotonic() - due_s)

    def add(self, delay_s: float) -> None:
        """Add one delay."""
        self._counts[min(_NUM_BINS, max(0, int(delay_s / _BIN_S)))] += 1
        self._num += 1
        self._recent_s = max(self._recent_s, delay_s)

    def quantile_s(self, share: float) -> float:
        """Return a quantile of the delays, to 0.1 ms; 0 before the first."""
        wanted, seen = share * self._num, 0
        for i, count in enumerate(self._counts):
            seen += count
            if count and seen >= wanted:
                return (i + 1) * _BIN_S
        return 0.0

    def recent_s(self) -> float:
        """Return the longest delay since the last call."""
        recent, self._recent_s = self._recent_s, 0.0
        return recent


@dataclass(slots=True)
class Pacer:
    """Paces frames by their stamps: `rate` 1.0 is real time, None is as fast as possible."""

    rate: float | None
    #: A longer gap of stamps is a time jump, without waiting.
    longest_gap_s: float = 60.0
    _first_ns: int | None = None
    _last_ns: int = 0
    _started_s: float = 0.0

    async def wait(self, stamp_ns: int, stopped: asyncio.Event | None = None) -> None:
        """Return when the frame of this stamp is due, or the run is `stopped`; a jump restarts the clock."""
        if self.rate is None:
            return
        now_s = time.monotonic()
        gap_ns = stamp_ns - self._last_ns
        if self._first_ns is None or not 0 <= gap_ns <= self.longest_gap_s * 1e9:
            self._first_ns, self._started_s = stamp_ns, now_s
        self._last_ns = stamp_ns
        due_s = self._started_s + (stamp_ns - self._first_ns) / 1e9 / self.rate
        if due_s <= now_s:
            return
        if stopped is None:
            await asyncio.sleep(due_s - now_s)
            return
        with suppress(TimeoutError):
            await asyncio.wait_for(stopped.wait(), due_s - now_s)


class StopRequest:
    """A request to end the run, from any task; waits end when the grace period after it is over."""

    def __init__(self) -> None:
        self.event = asyncio.Event()
        self._requested_s = 0.0

    @property
    def is_requested(self) -> bool:
        """Whether the run is ending."""
        return self.event.is_set()

    def request(self) -> None:
        """End the run after the current frame."""
        if not self.event.is_set():
            self._requested_s = time.monotonic()
            self.event.set()

    async def within_grace(self, coroutine: Coroutine[Any, Any, T], name: str, grace_s: float = 0.0) -> T | None:
        """Return a coroutine's result; None, after cancelling it, if it takes longer than the grace period."""
        task = asyncio.create_task(coroutine, name=name)
        requested = asyncio.create_task(self.event.wait(), name="stopped")
        try:
            await asyncio.wait({task, requested}, return_when=asyncio.FIRST_COMPLETED)
            if not task.done():
                left_s = self._requested_s + grace_s - time.monotonic()
                await asyncio.wait({task}, timeout=max(0.0, left_s))
            return task.result() if task.done() else None
        finally:
            task.cancel()
            requested.cancel()
            await asyncio.gather(task, requested, return_exceptions=True)
