"""How far a robot's clock is from ours, estimated from when its messages arrive.

A message arrives later than it was made, never earlier: the least difference of the last minute is the offset and the
shortest delay together. Stamps stay the robot's; the offset tells how old what comes is, and is shown to people.
"""

from __future__ import annotations

from collections import deque

_WINDOW_NS = 60_000_000_000
_STEP_NS = 1_000_000_000
_CONFIRMED = 3


class ClockOffset:
    """Follows the difference between arrival and stamp; a step of over a second that stays is a clock that was set."""

    def __init__(self) -> None:
        self.num_steps = 0
        # The least differences of the window, each later than the one before and greater: the first is the least.
        self._least: deque[tuple[int, int]] = deque()
        self._odd: list[int] = []

    @property
    def offset_ns(self) -> int | None:
        """Our clock less the robot's, and the shortest delay; None before the first stamp."""
        return self._least[0][1] if self._least else None

    def add(self, arrival_ns: int, stamp_ns: int) -> None:
        """Take a message; stamps that were never set tell nothing."""
        if stamp_ns <= 0:
            return
        difference_ns = arrival_ns - stamp_ns
        offset_ns = self.offset_ns
        if offset_ns is not None and abs(difference_ns - self._least[-1][1]) > _STEP_NS:
            self._odd = [kept for kept in self._odd if abs(kept - difference_ns) <= _STEP_NS] + [difference_ns]
            # A delay that grows is no step of the clock: a link that is behind lets go of it again.
            if len(self._odd) < _CONFIRMED or self._is_delay(difference_ns):
                return
            self._least.clear()
            self.num_steps += 1
        self._odd.clear()
        while self._least and self._least[-1][1] >= difference_ns:
            self._least.pop()
        self._least.append((arrival_ns, difference_ns))
        while arrival_ns - self._least[0][0] > _WINDOW_NS:
            self._least.popleft()

    def _is_delay(self, difference_ns: int) -> bool:
        """Return whether a difference may be a delay: later than usual, by less than a minute."""
        return 0 < difference_ns - self._least[0][1] < _WINDOW_NS

    def age_ns(self, arrival_ns: int, stamp_ns: int) -> int | None:
        """Return how long after the quickest a message came."""
        return arrival_ns - stamp_ns - self._least[0][1] if self._least else None
