"""How long work shows itself: a bar on a terminal, a plain line now and then elsewhere, JSON lines for machines."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Literal

from hickory_stream.json_text import dumps
from hickory_stream.terminal import clear_line

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.engine.run import Progress

Style = Literal["bar", "lines", "json", "none"]

_LINE_EVERY_S = 5.0
_BAR_EVERY_S = 0.1
_EVENT_EVERY_S = 0.5
_WIDTH = 30


class ProgressPrinter:
    """Prints progress to standard error; a call costs nothing when it is not yet time to print.

    `part` says which of several runs it is, such as "2 of 5".
    """

    def __init__(self, style: Style, where: Callable[[], str] | None = None, *, part: str = "") -> None:
        self._style = style
        self._part = part
        self._where = where
        self._started_s = time.monotonic()
        self._printed_s = 0.0
        self._phase = ""

    def __call__(self, progress: Progress) -> None:
        """Take note of where the run is."""
        now_s = time.monotonic()
        every_s = {"bar": _BAR_EVERY_S, "json": _EVENT_EVERY_S}.get(self._style, _LINE_EVERY_S)
        if self._style == "none" or (now_s - self._printed_s < every_s and progress.phase == self._phase):
            return
        self._printed_s, self._phase = now_s, progress.phase
        text = self._json(progress) if self._style == "json" else self._text(progress, now_s - self._started_s)
        if self._style == "bar":
            clear_line()
            sys.stderr.write(text)
        else:
            sys.stderr.write(text + "\n")
        sys.stderr.flush()

    def close(self) -> None:
        """End the line of the bar."""
        if self._style == "bar" and self._phase:
            sys.stderr.write("\n")

    def _text(self, progress: Progress, elapsed_s: float) -> str:
        part = f"{self._part}, " if self._part else ""
        rate = progress.frames / elapsed_s if elapsed_s > 0 else 0.0
        counts = f"{progress.objects} objects"
        if self._where is not None:
            counts = f"{self._where()}, {counts}"
        if progress.open_shapes:
            counts += f", {progress.open_shapes} shapes to come"
        if progress.total is None:
            return f"{part}{progress.phase}: frame {progress.frames}, {rate:.0f}/s, {counts}"
        left_s = (progress.total - progress.frames) / rate if rate > 0 else 0.0
        share = progress.frames / max(progress.total, 1)
        bar = ("#" * round(share * _WIDTH)).ljust(_WIDTH, ".") if self._style == "bar" else f"{share:.0%}"
        frames = f"frame {progress.frames}/{progress.total}"
        return f"{part}{progress.phase}: {bar} {frames}, {rate:.0f}/s, {left_s:.0f} s left, {counts}"

    def _json(self, progress: Progress) -> str:
        return dumps(
            {
                "event": "progress",
                **({"part": self._part} if self._part else {}),
                "phase": progress.phase,
                "frames": progress.frames,
                "total": progress.total,
                "keyframes": progress.keyframes,
                "objects": progress.objects,
                "open_shapes": progress.open_shapes,
            }
        )
