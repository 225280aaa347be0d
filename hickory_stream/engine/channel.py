"""A bounded, closable channel between two tasks of the loop; a full one makes the sender wait, or drops the oldest.

The end of the stream is an exception of its own, not a value in the stream.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

T = TypeVar("T")
WhenFull = Literal["wait", "drop_oldest"]


class ChannelClosed(Exception):
    """The channel was closed, and everything in it was taken."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelStatistics:
    """Items in the channel, its capacity, the most that it ever held, and how many were dropped."""

    length: int
    capacity: int
    peak: int
    dropped: int


class Channel(Generic[T]):
    """Buffered to `capacity`; one or more senders and receivers on one loop.

    `when_full` says what `send` does then: "wait" for room, or "drop_oldest" and never wait.
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
        """Put an item in; return the one that was dropped for it, None if none was.

        Raises:
            ChannelClosed: the channel was closed.
        """
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
        """Take the oldest item out, waiting for one.

        Raises:
            ChannelClosed: the channel was closed and is empty.
        """
        async with self._changed:
            await self._wait_for_items()
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    async def receive_all(self) -> list[T]:
        """Take out everything that is in the channel, the oldest first, waiting for at least one item.

        Raises:
            ChannelClosed: the channel was closed and is empty.
        """
        async with self._changed:
            await self._wait_for_items()
            items = list(self._items)
            self._items.clear()
            self._changed.notify_all()
            return items

    async def close(self) -> None:
        """End the stream: what is in it can still be taken."""
        async with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def statistics(self) -> ChannelStatistics:
        """Return how full the channel is, and was."""
        return ChannelStatistics(
            length=len(self._items), capacity=self._capacity, peak=self._peak, dropped=self._dropped
        )

    async def _wait_for_items(self) -> None:
        await self._changed.wait_for(lambda: self._items or self._is_closed)
        if not self._items:
            raise ChannelClosed
