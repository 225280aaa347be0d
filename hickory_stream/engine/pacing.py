"""Pacing of a playback: frames are due at a multiple of the rate of their stamps, or at once."""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass


@dataclass(slots=True)
class Pacer:
    """Paces frames by their stamps: `rate` 1.0 is real time, None is as fast as possible.

    A gap of more than `longest_gap_s` in the stamps is a time jump, for which it does not wait.
    """

    rate: float | None
    longest_gap_s: float = 60.0
    _first_ns: int | None = None
    _last_ns: int = 0
    _started_s: float = 0.0

    async def wait(self, stamp_ns: int, stopped: asyncio.Event | None = None) -> None:
        """Return when the frame of this stamp is due, or the run is `stopped`; a jump starts the clock anew."""
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
