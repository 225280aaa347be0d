"""Offset between a robot's clock and ours, from the arrival of its messages.

A message never arrives before it was made: the least difference of the last minute is offset plus shortest delay.
Stamps stay the robot's; the offset is only shown.
"""

from collections import deque

_WINDOW_NS = 60_000_000_000
_STEP_NS = 1_000_000_000
_CONFIRMED = 3


class ClockOffset:
    """Difference between arrival and stamp; a lasting step of over a second means that a clock was set."""

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
        """Add a message; stamps that were never set are ignored."""
        if stamp_ns <= 0:
            return
        difference_ns = arrival_ns - stamp_ns
        offset_ns = self.offset_ns
        if offset_ns is not None and abs(difference_ns - self._least[-1][1]) > _STEP_NS:
            self._odd = [kept for kept in self._odd if abs(kept - difference_ns) <= _STEP_NS] + [difference_ns]
            # A delay that grows is no step of the clock: a link that is behind lets go of it again.
            if len(self._odd) < _CONFIRMED or 0 < difference_ns - self._least[0][1] < _WINDOW_NS:
                return
            self._least.clear()
            self.num_steps += 1
        self._odd.clear()
        while self._least and self._least[-1][1] >= difference_ns:
            self._least.pop()
        self._least.append((arrival_ns, difference_ns))
        while arrival_ns - self._least[0][0] > _WINDOW_NS:
            self._least.popleft()
