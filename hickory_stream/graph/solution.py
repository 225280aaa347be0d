"""The answer of a solver: a `Solution`, or a `NoSolution` with its reason; never odometry's poses for a failure."""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze_all


@dataclass(frozen=True, kw_only=True, slots=True)
class RejectedLoop:
    """A loop that is not believed: `withdrawn` if an earlier solution had accepted it; `reason` is for people."""

    id: int
    status: Literal["rejected", "withdrawn"]
    reason: str


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solution:
    """The places of the nodes, and the accepted loops."""

    #: (N, 4, 4)
    world_from_node: NDArray[np.float64]
    #: (L,) of graduated non-convexity, in the graph's order; 0: impossible, 1: nothing but odometry against it
    loop_weights: NDArray[np.float64]
    #: ids, ascending
    accepted: tuple[int, ...]
    rejected: tuple[RejectedLoop, ...]
    #: of GTSAM, for the covariances of nodes
    marginals: Any
    #: of all factors, with `dof` degrees of freedom
    chi2: float
    dof: int

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, world_from_node=(None, 4, 4), loop_weights=(None,))


@dataclass(frozen=True, kw_only=True, slots=True)
class NoSolution:
    """The factors have no computable solution; `reason` is for people."""

    reason: str
