"""Classification of the stamps of one stream: in order, late, duplicate, implausible, or after a jump.

A stamp far from its neighbours is wrong, or the first after a jump: the next message decides.
A jump backwards begins a new epoch.
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum
from typing import Any

BACKWARDS_NS = 1_000_000_000
"""A stamp that is older than the newest by more than this is not counted as late."""

FORWARD_NS = 10_000_000_000
"""A step of more than this is a jump forward: a pause of the recording, or a clock that was set."""

_REMEMBERED = 256


class Order(Enum):
    """The class of a stamp with respect to those before it."""

    IN_ORDER = "in order"
    LATE = "late"
    DUPLICATE = "duplicate"
    OFF = "off"


@dataclass(frozen=True, slots=True)
class Placed:
    """A classified item; `jump_ns` is the jump of time right before it, 0 if there was none."""

    item: Any
    stamp_ns: int
    epoch: int
    order: Order
    jump_ns: int = 0


class Timeline:
    """Classifies the items of one stream; an odd one is held back until the next item decides."""

    def __init__(self) -> None:
        self.epoch = 0
        self._clock = 0
        self._newest_ns: int | None = None
        self._recent: deque[int] = deque(maxlen=_REMEMBERED)
        self._seen: set[int] = set()
        self._odd: tuple[int, Any] | None = None

    def add(self, stamp_ns: int, item: Any, clock: int = 0) -> list[Placed]:
        """Return the items that can be classified now, in order; none while an odd one is held back.

        `clock` is the number of steps of the clock before it; each begins another epoch.
        """
        if clock > self._clock:
            placed = self.end()
            self._begin(clock - self._clock)
            self._clock = clock
            return [*placed, self._take(stamp_ns, item, 0)]
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
            self._begin(int(jump_ns < 0))
            first = self._take(odd_ns, odd, jump_ns)
            return [first, *self.add(stamp_ns, item)]
        placed = self.end()
        self._odd = (stamp_ns, item)
        return placed

    def end(self) -> list[Placed]:
        """Return the odd item that was not confirmed, as one with a wrong stamp."""
        if self._odd is None:
            return []
        (stamp_ns, item), self._odd = self._odd, None
        return [Placed(item, stamp_ns, self.epoch, Order.OFF)]

    def _begin(self, num_epochs: int) -> None:
        self.epoch += num_epochs
        self._newest_ns = None
        self._recent.clear()
        self._seen.clear()

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
        assert self._newest_ns is not None
        if odd_ns > self._newest_ns:
            # Forward jumps include slow streams, in which every step is longer than a jump.
            return stamp_ns >= odd_ns
        return abs(stamp_ns - odd_ns) <= FORWARD_NS
