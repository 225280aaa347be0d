"""The notice while kernels are compiled: nothing for a few, a line now and then for more."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

from hickory_stream.outputs import output

if TYPE_CHECKING:
    from collections.abc import Callable

_AFTER_S = 1.5
_AFTER_KERNELS = 4
_EVERY_S = 5.0


class CompileNotice:
    """A listener of `compiling.tell_when_compiling`; as JSON lines where `as_json`."""

    def __init__(self, *, as_json: bool, clock: Callable[[], float] = time.monotonic) -> None:
        self._as_json = as_json
        self._clock = clock
        self._began_s: float | None = None
        self._said_s = 0.0
        self._num_compiled = 0

    def __call__(self, kernel: str) -> None:
        """Take note that a kernel is about to be compiled."""
        del kernel
        now_s = self._clock()
        if self._began_s is None:
            self._began_s, self._said_s = now_s, now_s + _AFTER_S - _EVERY_S
        if now_s - self._said_s >= _EVERY_S and self._num_compiled >= _AFTER_KERNELS:
            self._said_s = now_s
            seconds = now_s - self._began_s
            if self._as_json:
                text = output(
                    "compiling", {"event": "progress", "phase": "compiling", "num_compiled": self._num_compiled}
                )
            else:
                text = (
                    "compiling kernels, once after an installation or update: "
                    f"{self._num_compiled} so far, {seconds:.0f} s"
                )
            sys.stderr.write(text + "\n")
            sys.stderr.flush()
        self._num_compiled += 1
