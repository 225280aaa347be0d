"""Number and rate of a topic's messages."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

_WINDOW_S = 5


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
