"""Keys on a terminal that drive the playback clock: space, arrows and the full stop."""

from __future__ import annotations

import sys
import threading
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from players.playback import PlaybackClock

HELP = "space: pause; . : one frame; k: to the next keyframe; right, left: 10 s on or back; up, down: faster or slower"
_SEEK_S = 10.0
_RATES = (0.1, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, None)


class Keys:
    """While entered, keys drive a clock; does nothing where standard input is no terminal."""

    def __init__(self, clock: PlaybackClock) -> None:
        self._clock = clock
        self._saved: list[Any] | None = None
        self._ended = threading.Event()

    def __enter__(self) -> Self:
        """Take the terminal out of its line mode; Ctrl-C stays what it is."""
        if sys.platform != "win32" and sys.stdin.isatty():
            import termios
            import tty

            self._saved = termios.tcgetattr(sys.stdin.fileno())
            tty.setcbreak(sys.stdin.fileno())
            threading.Thread(target=self._read, name="keys", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """Give the terminal back."""
        self._ended.set()
        if self._saved is not None:
            import termios

            termios.tcsetattr(sys.stdin.fileno(), termios.TCSADRAIN, self._saved)

    def _read(self) -> None:
        import os
        import select

        while not self._ended.is_set():
            ready, _, _ = select.select([sys.stdin], [], [], 0.2)
            if ready:
                press(self._clock, os.read(sys.stdin.fileno(), 16))


def press(clock: PlaybackClock, keys: bytes) -> None:
    """Do what the keys say; unknown ones do nothing."""
    match keys:
        case b" ":
            clock.pause()
        case b".":
            clock.step("frame")
        case b"k":
            clock.step("keyframe")
        case b"\x1b[C":
            clock.seek(_SEEK_S, relative=True)
        case b"\x1b[D":
            clock.seek(-_SEEK_S, relative=True)
        case b"\x1b[A" | b"\x1b[B":
            place = _RATES.index(clock.rate) if clock.rate in _RATES else _RATES.index(1.0)
            step = 1 if keys == b"\x1b[A" else -1
            clock.set_rate(_RATES[min(max(place + step, 0), len(_RATES) - 1)])
