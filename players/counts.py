"""The ledger of one pass over a source: how many messages or files had which fate."""

from __future__ import annotations

from collections import Counter
from threading import Lock


class Ledger:
    """Counts by name; frames are decoded in other threads than the one that reads, hence the lock."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._lock = Lock()

    def count(self, fate: str, number: int = 1) -> None:
        """Add `number` to the count of a fate."""
        with self._lock:
            self._counts[fate] += number

    def as_dict(self) -> dict[str, int]:
        """Return the counts so far, sorted by name."""
        with self._lock:
            return dict(sorted(self._counts.items()))
