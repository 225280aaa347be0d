"""The delay of the event loop: how late it runs what is due, and so whether anything blocks it."""

from __future__ import annotations

import asyncio
import time

# Each look wakes the process: every 5 ms, that was most of the processor time of the event loop.
_PERIOD_S = 0.025
_BIN_S = 0.0001
_NUM_BINS = 20_000


class LoopDelay:
    """A histogram of delays in steps of 0.1 ms up to 2 s, fed by `watch` every 25 ms."""

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
        """Note one delay."""
        self._counts[min(_NUM_BINS, max(0, int(delay_s / _BIN_S)))] += 1
        self._num += 1
        self._recent_s = max(self._recent_s, delay_s)

    def quantile_s(self, share: float) -> float:
        """Return the delay that this share of all was no longer than, to 0.1 ms; 0 before the first."""
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
