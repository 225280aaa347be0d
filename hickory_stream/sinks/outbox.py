"""What waits to be sent to a robot: bounded, sent in a thread of its own, and every message is counted by its fate."""

from __future__ import annotations

import threading
from collections import Counter, deque
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Callable

MOST_BYTES = 16 << 20
_CLOSE_S = 2.0


class ReturnLink(Protocol):
    """The way back to a robot: a live route that can publish. `send` may take long, and never raises."""

    def offer(self, name: str, type_name: str, *, definition: str, type_hash: str, is_latched: bool) -> None:
        """Announce a topic, now and whenever the link comes back; of a latched one the last message is kept."""
        ...

    def send(self, name: str, data: bytes) -> bool:
        """Publish a message of an offered topic; return False where nobody is there to take it."""
        ...

    def listen(self, name: str, hear: Callable[[bytes], None]) -> None:
        """Have what is published under a name handed over as it comes, on a thread of the link's."""
        ...


class Outbox:
    """Sends messages in their order; where they take too much room the oldest go.

    `overtaken` is told the name of a message that was dropped. Fates: `sent`, `unheard` (nobody there), `dropped`.
    """

    def __init__(
        self, link: ReturnLink, overtaken: Callable[[str], None] = lambda name: None, *, most_bytes: int = MOST_BYTES
    ) -> None:
        self._link = link
        self._overtaken = overtaken
        self._most_bytes = most_bytes
        self._changed = threading.Condition()
        self._waiting: deque[tuple[str, bytes]] = deque()
        self._num_bytes = 0
        self._is_over = False
        self._fates: Counter[tuple[str, str]] = Counter()
        self._thread = threading.Thread(target=self._run, name="publish", daemon=True)
        self._thread.start()

    def put(self, name: str, data: bytes, *, is_urgent: bool = False) -> None:
        """Have a message sent; an urgent one before all others."""
        dropped: list[str] = []
        with self._changed:
            if is_urgent:
                self._waiting.appendleft((name, data))
            else:
                self._waiting.append((name, data))
            self._num_bytes += len(data)
            while self._num_bytes > self._most_bytes and len(self._waiting) > 1:
                old, content = self._waiting.popleft()
                self._num_bytes -= len(content)
                self._fates[old, "dropped"] += 1
                dropped.append(old)
            self._changed.notify()
        for old in dropped:
            self._overtaken(old)

    def fates(self) -> dict[str, dict[str, int]]:
        """Return by topic how many messages had which fate so far."""
        with self._changed:
            found: dict[str, dict[str, int]] = {}
            for (name, fate), number in sorted(self._fates.items()):
                found.setdefault(name, {})[fate] = number
            return found

    def close(self) -> None:
        """Send what waits, for a moment, and end; what is left then is counted as dropped."""
        with self._changed:
            self._is_over = True
            self._changed.notify()
        self._thread.join(_CLOSE_S)
        with self._changed:
            for name, _ in self._waiting:
                self._fates[name, "dropped"] += 1
            self._waiting.clear()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_over)
                if not self._waiting:
                    return
                name, data = self._waiting.popleft()
                self._num_bytes -= len(data)
            is_heard = self._link.send(name, data)
            with self._changed:
                self._fates[name, "sent" if is_heard else "unheard"] += 1
