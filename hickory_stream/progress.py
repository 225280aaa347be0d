"""Progress of long work: a bar on a terminal, plain lines elsewhere, JSON lines for machines."""

import dataclasses
import math
import sys
import time
from collections import deque
from collections.abc import Callable
from typing import Literal

from hickory_stream.base.terminal import clear_line
from hickory_stream.engine.modes import Progress
from hickory_stream.outputs import output

Style = Literal["bar", "lines", "json", "none"]

_LINE_EVERY_S = 5.0
_BAR_EVERY_S = 0.1
_EVENT_EVERY_S = 0.5
_WIDTH = 30
_RATE_OVER_S = 15.0
# Before that the rate is unknown: the first frames load modules and kernels.
_RATE_AFTER_S = 3.0
_RATE_AFTER_FRAMES = 8


class ProgressPrinter:
    """Prints progress to standard error, rarely; `part` names one of several runs, such as "2 of 5"."""

    def __init__(
        self,
        style: Style,
        where: Callable[[], str] | None = None,
        *,
        part: str = "",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._style = style
        self._part = part
        self._where = where
        self._clock = clock
        self._phase_began_s = clock()
        self._printed_s = -math.inf
        self._phase = ""
        # Moments and frames of the last seconds: how fast it is now, rather than since the start.
        self._recent: deque[tuple[float, int]] = deque()

    def __call__(self, progress: Progress) -> None:
        """Update the progress of the run."""
        now_s = self._clock()
        self._note(progress, now_s)
        every_s = {"bar": _BAR_EVERY_S, "json": _EVENT_EVERY_S}.get(self._style, _LINE_EVERY_S)
        if self._style == "none" or (now_s - self._printed_s < every_s and progress.phase == self._phase):
            return
        self._printed_s, self._phase = now_s, progress.phase
        text = self._json(progress) if self._style == "json" else self._text(progress, now_s)
        if self._style == "bar":
            clear_line()
        sys.stderr.write(text if self._style == "bar" else f"{text}\n")
        sys.stderr.flush()

    def close(self) -> None:
        """End the line of the bar."""
        if self._style == "bar" and self._phase:
            sys.stderr.write("\n")

    def _note(self, progress: Progress, now_s: float) -> None:
        if progress.phase != self._phase:
            self._phase_began_s = now_s
            self._recent.clear()
        if not self._recent or progress.frames != self._recent[-1][1]:
            self._recent.append((now_s, progress.frames))
        while len(self._recent) > 2 and now_s - self._recent[1][0] > _RATE_OVER_S:
            self._recent.popleft()

    def _rate(self, now_s: float) -> float | None:
        # Over the latest frames; None while there are too few.
        since_s, since_frames = self._recent[0]
        num_frames = self._recent[-1][1] - since_frames
        if now_s - since_s < _RATE_AFTER_S or num_frames < _RATE_AFTER_FRAMES:
            return None
        return num_frames / (now_s - since_s)

    def _text(self, progress: Progress, now_s: float) -> str:
        part = f"{self._part}, " if self._part else ""
        if progress.phase == "compiling":
            done = self._bar(progress.num_compiled / max(progress.num_kernels, 1))
            seconds = f"{now_s - self._phase_began_s:.0f} s so far"
            of = f"{progress.num_compiled} of about {progress.num_kernels}"
            return f"{part}compiling kernels, once after an installation or update: {done} {of}, {seconds}"
        counts = f"{progress.objects} objects"
        if self._where is not None:
            counts = f"{self._where()}, {counts}"
        if progress.open_shapes:
            counts += f", {progress.open_shapes} shapes to come"
            counts += " once their kernels are compiled" if progress.num_kernels else ""
        rate = self._rate(now_s)
        if progress.total is None:
            speed = "" if rate is None else f" {_shown(rate)}/s,"
            return f"{part}{progress.phase}: frame {progress.frames},{speed} {counts}"
        left = progress.total - progress.frames
        speed = "" if rate is None or left <= 0 else f" {_shown(rate)}/s, {left / rate:.0f} s left,"
        done = self._bar(progress.frames / max(progress.total, 1))
        return f"{part}{progress.phase}: {done} frame {progress.frames}/{progress.total},{speed} {counts}"

    def _bar(self, share: float) -> str:
        return ("#" * round(share * _WIDTH)).ljust(_WIDTH, ".") if self._style == "bar" else f"{share:.0%}"

    def _json(self, progress: Progress) -> str:
        return output(
            "progress",
            {
                "event": "progress",
                **({"part": self._part} if self._part else {}),
                **dataclasses.asdict(progress),
            },
        )


def _shown(rate: float) -> str:
    return f"{rate:.0f}" if rate >= 10 else f"{rate:.1f}"
