"""When the state of the core is written: every so many keyframes, and while no search for loops is open."""

from __future__ import annotations

_LONGEST_WAIT = 2


class CheckpointTimes:
    """Counts the keyframes since the last checkpoint; `keyframes`: one is due after so many.

    A search that is open has the whole map as it was when it was asked for, and the surfaces of all submaps: in a
    building that is thirty times what has changed. So one waits until it is answered, at most twice as long.
    """

    def __init__(self, keyframes: int) -> None:
        self._keyframes = keyframes
        self._since = 0

    def is_due(self, *, searches: bool) -> bool:
        """Return whether the core is to be written after one more keyframe; `searches`: some search is open."""
        self._since += 1
        is_due = self._since >= self._keyframes * (_LONGEST_WAIT if searches else 1)
        if is_due:
            self._since = 0
        return is_due
