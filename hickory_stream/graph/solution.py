"""What a solver answers: a `Solution`, or a `NoSolution` with its reason; never odometry's poses for a failure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from hickory_stream.geometry.arrays import freeze

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class RejectedLoop:
    """A loop that is not believed: `withdrawn` if an earlier solution had accepted it; `reason` is for people."""

    id: int
    status: Literal["rejected", "withdrawn"]
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solution:
    """Where the nodes lie, and which loops are believed.

    `world_from_node` (N, 4, 4). `loop_weights` (L,) are those of graduated non-convexity in the order of the graph's
    loops, 0 where a loop was impossible to begin with, 1 where nothing but odometry had spoken against it. `accepted`
    are ids, ascending. `chi2` with `dof` degrees of freedom says how well all of it fits.
    """

    world_from_node: NDArray[np.float64]
    loop_weights: NDArray[np.float64]
    accepted: tuple[int, ...]
    rejected: tuple[RejectedLoop, ...]
    chi2: float
    dof: int

    def __post_init__(self) -> None:
        freeze(self, "world_from_node", np.float64, (None, 4, 4))
        freeze(self, "loop_weights", np.float64, (None,))


@dataclass(frozen=True, kw_only=True, slots=True)
class NoSolution:
    """The factors have no solution that can be computed; `reason` is for people."""

    reason: str
