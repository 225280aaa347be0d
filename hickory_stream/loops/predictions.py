"""The place of a submap in the earlier ones by the pose graph, where a search for loops begins."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import compose, invert
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.solution import NoSolution
from hickory_stream.loops.pose_graph import Node, pose_graph, world_from_submaps
from hickory_stream.records import Loop


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Predicted:
    """The place of the later submap in an earlier one: `earlier_from_later` (4, 4) between their frames."""

    earlier_from_later: NDArray[np.float64]
    #: in a horizontal direction
    sigma_m: float
    #: about the vertical
    sigma_yaw_rad: float

    def __post_init__(self) -> None:
        freeze(self, "earlier_from_later", np.float64, (4, 4))


def predictions(
    submaps: Sequence[Node], loops: Sequence[Loop], config: GraphConfig, *, least_apart: int
) -> dict[int, Predicted] | NoSolution:
    """Return the place of the last submap in each at least `least_apart` before it, by id (its index)."""
    from hickory_stream.graph.solve import relative_covariances, solve

    later_id = len(submaps) - 1
    solution = solve(pose_graph(submaps, loops, [0] * len(submaps), config), config)
    if isinstance(solution, NoSolution):
        return solution
    earlier_ids = range(max(0, later_id - least_apart + 1))
    covariances = relative_covariances(solution, [(i, later_id) for i in earlier_ids])
    world_from = world_from_submaps(submaps, solution.world_from_node)
    return {
        i: Predicted(
            earlier_from_later=compose(invert(world_from[i]), world_from[later_id]),
            sigma_m=float(np.sqrt(covariance.diagonal()[3:].max())),
            sigma_yaw_rad=float(np.sqrt(covariance.diagonal()[:3].max())),
        )
        for i, covariance in zip(earlier_ids, covariances, strict=True)
    }
