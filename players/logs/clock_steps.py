"""Steps of the robot's clock, found by log time against header stamps in the stream of all messages.

When a clock is set, the stamps of several topics move against log time at once and for good, while messages keep coming
at their usual rate; a delay does the opposite. If the recorder's clock is the same, the messages of a topic go back in
both times. Messages are held for a moment only while a step is suspected.
"""

from collections import Counter, deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from statistics import median
from typing import Any, NamedTuple

LEAST_STEP_NS, _STEADY_NS = 30_000_000, 100_000_000
_WINDOW = 15
_LEAST_KNOWN, _LEAST_MOVED = 5, 3
_CONFIRM_NS, _MOST_NS, _MOST_HELD = 300_000_000, 1_000_000_000, 500
# A stream is regular whose steps differ by less than this share; crowded are stamps that follow in this share of one.
_REGULAR, _CROWDED, _MIXED = 0.7, 0.6, 0.3
_MOST_CROWDED_NS = 30_000_000_000
_PATIENCE = 20
"""How often log time may go back, without a step, before the file counts as unordered."""


class Timed(NamedTuple):
    """A message with its topic, header stamp (None without one) and log time; `shift_ns` is in the stamp already."""

    topic: str
    stamp_ns: int | None
    log_ns: int
    message: Any
    shift_ns: int = 0

    def shifted(self, shift_ns: int) -> "Timed":
        """Return the message with a corrected stamp."""
        stamp_ns = self.stamp_ns + shift_ns if self.stamp_ns else self.stamp_ns
        return self._replace(stamp_ns=stamp_ns, shift_ns=self.shift_ns + shift_ns)


@dataclass(slots=True)
class _Stream:
    lags_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    periods_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    #: From stamp to stamp.
    steps_ns: deque[int] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    last: tuple[int, int] = (0, 0)

    def take(self, stamp_ns: int, log_ns: int) -> None:
        if self.lags_ns:
            self.periods_ns.append(log_ns - self.last[1])
            self.steps_ns.append(stamp_ns - self.last[0])
        self.lags_ns.append(log_ns - stamp_ns)
        self.last = (stamp_ns, log_ns)

    def moved_ns(self, stamp_ns: int, log_ns: int) -> int:
        """Return how far the lag is from the usual one; 0 within its scatter."""
        if len(self.lags_ns) < _LEAST_KNOWN:
            return 0
        low_ns, high_ns, lag_ns = min(self.lags_ns), max(self.lags_ns), log_ns - stamp_ns
        margin_ns = max(LEAST_STEP_NS, high_ns - low_ns)
        return 0 if low_ns - margin_ns <= lag_ns <= high_ns + margin_ns else lag_ns - int(median(self.lags_ns))

    def is_crowded(self, gap_ns: int) -> bool:
        """Return whether a stamp follows too soon for a stream that was regular."""
        is_close = bool(self.steps_ns) and 0 <= gap_ns < _CROWDED * self.steps_ns[-1]
        return is_close and self.is_regular and gap_ns < _CROWDED * min(self.steps_ns)

    @property
    def is_regular(self) -> bool:
        """Whether its stamps come at one rate."""
        return len(self.steps_ns) >= _LEAST_KNOWN and min(self.steps_ns) > _REGULAR * max(self.steps_ns)

    def is_mixed(self, seen: list[tuple[int, int]]) -> bool:
        """Return whether many of some messages follow too soon."""
        stamps_ns = [self.last[0], *(stamp_ns for stamp_ns, _ in seen)]
        return sum(self.is_crowded(now - then) for then, now in pairwise(stamps_ns)) >= _MIXED * len(seen)

    def lasting_ns(self, seen: list[tuple[int, int]]) -> int:
        """Return by how much stamps moved for good; 0 if they did not, or if messages came late instead."""
        moved_ns = [self.moved_ns(*times) for times in seen]
        first = next((i for i, off_ns in enumerate(moved_ns) if off_ns), None)
        if first is None or not all(_is_same(off_ns, moved_ns[first]) for off_ns in moved_ns[first:]):
            return 0
        is_late = self.is_late(*seen[first], seen[first - 1] if first else self.last)
        return 0 if is_late else int(median(moved_ns[first:]))

    def is_late(self, stamp_ns: int, log_ns: int, last: tuple[int, int]) -> bool:
        """Return whether the log time left its period rather than the stamp: the message was delayed."""
        period_ns = median(self.periods_ns)
        return abs(stamp_ns - last[0] - period_ns) <= abs(log_ns - last[1] - period_ns)

    def back_ns(self, stamp_ns: int, log_ns: int) -> int:
        """Return how far both times were set back; 0 if they do not go back."""
        back_ns, log_back_ns = self.last[0] - stamp_ns, self.last[1] - log_ns
        is_back = len(self.lags_ns) >= _LEAST_KNOWN and min(back_ns, log_back_ns) > 0
        return back_ns + int(median(self.periods_ns)) if is_back and _is_same(log_back_ns, back_ns) else 0


class ClockSteps:
    """Numbers the messages of a log by the times that the robot's clock was set back before."""

    def __init__(self) -> None:
        self.number = 0
        #: One line per step, and whether it does harm.
        self.texts: dict[str, bool] = {}
        self._streams: dict[str, _Stream] = {}
        self._held: list[Timed] = []
        self._shifts_ns: dict[str, int] = {}
        self._newest_log_ns = 0
        self._num_unordered = 0
        # While two times lie between each other: since when, and how often a stream was regular again.
        self._crowded_ns: int | None = None
        self._calm: Counter[str] = Counter()

    def lag_ns(self, topic: str) -> int | None:
        """Return the usual time from stamp to log time, None if it is not steady or there are few messages."""
        lags_ns = self._streams[topic].lags_ns if topic in self._streams else ()
        is_steady = len(lags_ns) >= _LEAST_KNOWN and max(lags_ns) - min(lags_ns) < _STEADY_NS
        return int(median(lags_ns)) if is_steady else None

    def forget(self) -> None:
        """Forget the lags so far, as after a long pause."""
        self._streams.clear()

    def numbered(self, messages: Iterable[Timed]) -> Iterator[tuple[Timed, int]]:
        """Yield each message with the number of steps back before it; -1 for one whose time is not certain."""
        for timed in messages:
            if timed.topic in self._shifts_ns:
                timed = timed.shifted(self._shifts_ns[timed.topic])
            if self._crowded_ns is not None:
                yield timed, self._calm_down(timed)
                continue
            if not self._held and not self._is_odd(timed):
                self._take(timed)
                yield timed, self.number
                continue
            self._held.append(timed)
            span_ns = timed.log_ns - self._held[0].log_ns
            if span_ns >= _CONFIRM_NS or len(self._held) >= _MOST_HELD:
                yield from self._decided(is_last=span_ns > _MOST_NS or len(self._held) >= _MOST_HELD)
        if self._held:
            yield from self._decided(is_last=True)
        if self._crowded_ns is not None:
            self._report_crowd(self._newest_log_ns)

    def _calm_down(self, timed: Timed) -> int:
        self._newest_log_ns = timed.log_ns
        if not timed.stamp_ns:
            return self.number
        if (stream := self._streams.get(timed.topic)) is not None:
            is_calm = not stream.is_crowded(timed.stamp_ns - stream.last[0])
            self._calm[timed.topic] = self._calm[timed.topic] + 1 if is_calm else 0
            stream.last = (timed.stamp_ns, timed.log_ns)
            is_over = self._calm[timed.topic] >= _LEAST_MOVED and stream.is_regular
            if is_over or timed.log_ns - (self._crowded_ns or 0) > _MOST_CROWDED_NS:
                self._report_crowd(timed.log_ns)
                self._streams, self._calm, self.number = {}, Counter(), self.number + 1
        return -1

    def _report_crowd(self, end_ns: int) -> None:
        assert self._crowded_ns is not None
        text = f"from log time {self._crowded_ns / 1e9:.3f} s to {end_ns / 1e9:.3f} s messages of two times are mixed"
        self._crowded_ns = None
        self.texts[f"{text}, as if sorted after a clock was set back: they are left out; play the unsorted log"] = True

    def _take(self, timed: Timed) -> None:
        self._newest_log_ns = max(self._newest_log_ns, timed.log_ns)
        if timed.stamp_ns:
            self._streams.setdefault(timed.topic, _Stream()).take(timed.stamp_ns, timed.log_ns)

    def _is_odd(self, timed: Timed) -> bool:
        if not timed.stamp_ns or (stream := self._streams.get(timed.topic)) is None:
            return False
        is_back = timed.log_ns < self._newest_log_ns - LEAST_STEP_NS and self._num_unordered < _PATIENCE
        # A delay, as while a live reader is busy, is no step: holding what follows would delay it further.
        times = (timed.stamp_ns, timed.log_ns)
        is_moved = stream.moved_ns(*times) != 0 and not stream.is_late(*times, stream.last)
        return is_back or is_moved or stream.is_crowded(timed.stamp_ns - stream.last[0])

    def _decided(self, *, is_last: bool) -> Iterator[tuple[Timed, int]]:
        by_topic: dict[str, list[tuple[int, int]]] = {}
        for timed in self._held:
            if timed.stamp_ns and timed.topic in self._streams:
                by_topic.setdefault(timed.topic, []).append((timed.stamp_ns, timed.log_ns))
        often = {name for name, seen in by_topic.items() if len(seen) >= _LEAST_MOVED}
        is_back = self._held[0].log_ns < self._newest_log_ns - LEAST_STEP_NS
        back = {name: off_ns for name, seen in by_topic.items() if (off_ns := self._streams[name].back_ns(*seen[0]))}
        if is_back and often & back.keys():
            yield from self._stepped(max(back.values()), goes_with_log=True)
            return
        regular = [name for name in often if self._streams[name].is_regular]
        is_mixed = len(regular) > 1 and all(self._streams[name].is_mixed(by_topic[name]) for name in regular)
        if is_mixed and not self._has_twins():
            self._crowded_ns = self._held[0].log_ns
            held, self._held = self._held, []
            for timed in held:
                yield timed, self._calm_down(timed)
            return
        moved = {name: off_ns for name, seen in by_topic.items() if (off_ns := self._streams[name].lasting_ns(seen))}
        step_ns = int(median(moved.values())) if moved else 0
        agreed = {name for name, off_ns in moved.items() if _is_same(off_ns, step_ns)}
        known = {name: seen for name, seen in by_topic.items() if len(self._streams[name].lags_ns) >= _LEAST_KNOWN}
        stayed = [name for name, seen in known.items() if not self._streams[name].moved_ns(*seen[-1])]
        if agreed & often and not stayed:
            yield from self._stepped(step_ns, goes_with_log=False)
        elif not moved or is_last:
            held, self._held, agreed = self._held, [], agreed if agreed & often else set()
            if agreed:
                clock = f"the clock of {', '.join(sorted(agreed))} alone was"
                self._report(held[0], step_ns, clock, "others went on, and its stamps are corrected", False)
                self._shifts_ns |= {name: self._shifts_ns.get(name, 0) + step_ns for name in agreed}
            self._num_unordered += is_back
            for name in by_topic.keys() - agreed:
                self._streams[name].lags_ns.clear()
            for timed in held:
                if timed.topic in agreed and timed.stamp_ns:
                    moved_ns = self._streams[timed.topic].moved_ns(timed.stamp_ns, timed.log_ns)
                    timed = timed.shifted(step_ns if _is_same(moved_ns, step_ns) else 0)
                self._take(timed)
                yield timed, self.number

    def _has_twins(self) -> bool:
        # Messages that were recorded twice, as by logs that overlap.
        seen = Counter((t.topic, t.stamp_ns, bytes(getattr(t.message, "data", b""))) for t in self._held if t.stamp_ns)
        return max(seen.values(), default=0) > 1

    def _stepped(self, step_ns: int, *, goes_with_log: bool) -> Iterator[tuple[Timed, int]]:
        result = "frames before and after it keep their own poses" if step_ns > 0 else "no frame is lost by it"
        self._report(self._held[0], step_ns, "the robot's clock was", result, False)
        (held, self._held), (streams, self._streams) = (self._held, []), (self._streams, {})
        before, self.number = self.number, self.number + (step_ns > 0)
        self._newest_log_ns = held[0].log_ns
        for timed in held:
            # Messages from before the step may still arrive behind it.
            lags_ns = streams[timed.topic].lags_ns if timed.topic in streams else ()
            lag_ns = timed.log_ns - (timed.stamp_ns or 0)
            is_before = len(lags_ns) >= _LEAST_KNOWN and abs(lag_ns - median(lags_ns)) < abs(step_ns) / 2
            if is_before and timed.stamp_ns and not goes_with_log:
                yield timed, before
            else:
                self._take(timed)
                yield timed, self.number

    def _report(self, first: Timed, step_ns: int, clock: str, result: str, is_harmful: bool) -> None:
        way, at_s = "back" if step_ns > 0 else "ahead", first.log_ns / 1e9
        text = f"{clock} set {way} by {abs(step_ns) / 1e9:.2f} s at log time {at_s:.3f} s: {result}"
        self.texts[text] = is_harmful


def _is_same(a_ns: int, b_ns: int) -> bool:
    return abs(a_ns - b_ns) <= LEAST_STEP_NS + abs(b_ns) // 5
