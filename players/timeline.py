"""Classification of the stamps of one stream: in order, late, duplicate, implausible, or after a jump.

A stamp far from its neighbours is either one that is wrong or the first after a jump; the message behind it tells:
if that goes on where the odd one was, time has jumped, and everything before a jump backwards is another epoch.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Any

BACKWARDS_NS = 1_000_000_000
"""What is older than the newest by more than this is no late message."""

FORWARD_NS = 10_000_000_000
"""A step of more than this is a jump forward: a pause of the recording, or a clock that was set."""

_REMEMBERED = 256


class Order(Enum):
    """How a stamp lies among those before it."""

    IN_ORDER = "in order"
    LATE = "late"
    DUPLICATE = "duplicate"
    OFF = "off"


@dataclass(frozen=True, slots=True)
class Placed:
    """An item with its place in time; `jump_ns` is how far time jumped right before it, 0 where it did not."""

    item: Any
    stamp_ns: int
    epoch: int
    order: Order
    jump_ns: int = 0


class Timeline:
    """Places the items of one stream; an odd one is held back until the next tells what it is."""

    def __init__(self) -> None:
        self.epoch = 0
        self._newest_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_REMEMBERED)
        self._seen: set[int] = set()
        self._odd: tuple[int, Any] | None = None

    def add(self, stamp_ns: int, item: Any) -> list[Placed]:
        """Return what can be placed now, in order; nothing while an odd one is waited for."""
        if self._newest_ns is None:
            return [self._take(stamp_ns, item, 0)]
        if self._is_near(stamp_ns):
            placed = self.end()
            if stamp_ns in self._seen:
                return [*placed, Placed(item, stamp_ns, self.epoch, Order.DUPLICATE)]
            return [*placed, self._take(stamp_ns, item, 0)]
        if self._odd is None:
            self._odd = (stamp_ns, item)
            return []
        odd_ns, odd = self._odd
        if self._goes_on(odd_ns, stamp_ns):
            self._odd = None
            jump_ns = odd_ns - self._newest_ns
            if jump_ns < 0:
                self.epoch += 1
            self._newest_ns = None
            self._recent.clear()
            self._seen.clear()
            first = self._take(odd_ns, odd, jump_ns)
            return [first, *self.add(stamp_ns, item)]
        placed = self.end()
        self._odd = (stamp_ns, item)
        return placed

    def end(self) -> list[Placed]:
        """Return the odd one that nothing confirmed, as one whose stamp is off."""
        if self._odd is None:
            return []
        (stamp_ns, item), self._odd = self._odd, None
        return [Placed(item, stamp_ns, self.epoch, Order.OFF)]

    def _take(self, stamp_ns: int, item: Any, jump_ns: int) -> Placed:
        is_late = self._newest_ns is not None and stamp_ns < self._newest_ns
        self._newest_ns = max(stamp_ns, self._newest_ns) if self._newest_ns is not None else stamp_ns
        if len(self._recent) == _REMEMBERED:
            self._seen.discard(self._recent[0])
        self._recent.append(stamp_ns)
        self._seen.add(stamp_ns)
        return Placed(item, stamp_ns, self.epoch, Order.LATE if is_late else Order.IN_ORDER, jump_ns)

    def _is_near(self, stamp_ns: int) -> bool:
        assert self._newest_ns is not None
        return -BACKWARDS_NS <= stamp_ns - self._newest_ns <= FORWARD_NS

    def _goes_on(self, odd_ns: int, stamp_ns: int) -> bool:
        """Return whether a stamp continues what the odd one began."""
        assert self._newest_ns is not None
        if odd_ns > self._newest_ns:
            # Forward: also a slow stream, of which every step is longer than a jump.
            return stamp_ns >= odd_ns
        return abs(stamp_ns - odd_ns) <= FORWARD_NS
