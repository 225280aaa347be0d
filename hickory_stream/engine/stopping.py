"""The request to end a run, and the grace period in which work that was begun may finish."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Coroutine

T = TypeVar("T")


class Stop:
    """Requested once, by any task; whoever waits for something does so until the grace after the request is over."""

    def __init__(self) -> None:
        self.event = asyncio.Event()
        self._requested_s = 0.0

    @property
    def is_requested(self) -> bool:
        """Whether the run is to end."""
        return self.event.is_set()

    def request(self) -> None:
        """End the run after the frame at hand."""
        if not self.event.is_set():
            self._requested_s = time.monotonic()
            self.event.set()

    async def within_grace(self, coroutine: Coroutine[Any, Any, T], name: str, grace_s: float = 0.0) -> T | None:
        """Return what a coroutine gives; it is cancelled, and None, where it takes longer than the grace."""
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
