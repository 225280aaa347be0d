"""Counts of one pass over a source: messages or files that were used, rejected or unreadable."""

from __future__ import annotations

from collections import Counter
from threading import Lock


class Ledger:
    """Counts by name, with a lock, since frames are decoded in other threads than the reading one.

    `read` and `rejected` count by topic; a message that was read, and is neither rejected nor unreadable, is used.
    """

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = Lock()
        self.read: Counter[str] = Counter()
        self.unreadable: Counter[str] = Counter()
        self.rejected: Counter[tuple[str, str]] = Counter()
        self.is_complete = False

    def count(self, fate: str, number: int = 1) -> None:
        """Add `number` to the count of that name."""
        with self._lock:
            self._counts[fate] += number

    def reject(self, topic: str, reason: str) -> None:
        """Note a message that was read and cannot be used; called by the thread that reads."""
        self.rejected[topic, reason] += 1

    def as_dict(self) -> dict[str, int]:
        """Return the counts so far, sorted by name."""
        with self._lock:
            return dict(sorted((fate, number) for fate, number in self._counts.items() if number))
