"""The two ways to run: a "playback" waits wherever something is full, a "live" run waits for nothing.

Where a run is, for whoever waits for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Mode = Literal["playback", "live"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """Where a run is: for the bar. `frames` of `total` (None: unknown), `phase` in a word.

    While the phase is `compiling`, `num_compiled` kernels of about `num_kernels` are.
    """

    phase: str
    frames: int
    total: int | None
    keyframes: int
    objects: int
    open_shapes: int
    num_compiled: int = 0
    num_kernels: int = 0
