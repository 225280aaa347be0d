"""The playback clock: when a frame is due, at a rate, or at once."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass


@dataclass(slots=True)
class Pump:
    """Paces frames by their stamps: `rate` 1.0 is real time, None is as fast as can be."""

    rate: float | None
    _first_ns: int | None = None
    _last_ns: int = 0
    _started_s: float = 0.0

    async def wait(self, stamp_ns: int) -> None:
        """Return when the frame of this stamp is due; a jump back starts the clock anew."""
        if self.rate is None:
            return
        now_s = time.monotonic()
        if self._first_ns is None or stamp_ns < self._last_ns:
            self._first_ns, self._started_s = stamp_ns, now_s
        self._last_ns = stamp_ns
        due_s = self._started_s + (stamp_ns - self._first_ns) / 1e9 / self.rate
        if due_s > now_s:
            await asyncio.sleep(due_s - now_s)
