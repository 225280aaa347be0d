"""A bounded, closable channel between two tasks of the loop; a full one makes the sender wait.

The end of the stream is an exception of its own, not a value in the stream.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")


class ChannelClosed(Exception):
    """The channel was closed, and everything in it was taken."""


@dataclass(frozen=True, kw_only=True, slots=True)
class ChannelStatistics:
    """Items in the channel, its capacity, and the most that it ever held."""

    length: int
    capacity: int
    peak: int


class Channel(Generic[T]):
    """Buffered to `capacity`; one or more senders and receivers on one loop; `send` waits while it is full."""

    def __init__(self, capacity: int) -> None:
        if capacity < 1:
            raise ValueError(f"a channel of capacity {capacity}")
        self._items: deque[T] = deque()
        self._capacity = capacity
        self._peak = 0
        self._is_closed = False
        self._changed = asyncio.Condition()

    async def send(self, item: T) -> None:
        """Put an item in, waiting for room.

        Raises:
            ChannelClosed: the channel was closed.
        """
        async with self._changed:
            await self._changed.wait_for(lambda: len(self._items) < self._capacity or self._is_closed)
            if self._is_closed:
                raise ChannelClosed
            self._items.append(item)
            self._peak = max(self._peak, len(self._items))
            self._changed.notify_all()

    async def receive(self) -> T:
        """Take the oldest item out, waiting for one.

        Raises:
            ChannelClosed: the channel was closed and is empty.
        """
        async with self._changed:
            await self._changed.wait_for(lambda: self._items or self._is_closed)
            if not self._items:
                raise ChannelClosed
            item = self._items.popleft()
            self._changed.notify_all()
            return item

    async def close(self) -> None:
        """End the stream: what is in it can still be taken."""
        async with self._changed:
            self._is_closed = True
            self._changed.notify_all()

    def statistics(self) -> ChannelStatistics:
        """Return how full the channel is."""
        return ChannelStatistics(length=len(self._items), capacity=self._capacity, peak=self._peak)
