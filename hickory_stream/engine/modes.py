"""The two modes of a run, and its progress: a "playback" waits for everything, a "live" run never waits."""

from dataclasses import dataclass
from typing import Literal

Mode = Literal["playback", "live"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Progress:
    """Progress of a run, for the bar."""

    phase: str
    frames: int
    #: None if unknown.
    total: int | None
    keyframes: int
    objects: int
    open_shapes: int
    #: Compiled kernels of about `num_kernels`, which is 0 once all are compiled.
    num_compiled: int = 0
    num_kernels: int = 0
