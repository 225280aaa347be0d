"""Joint placement of several maps: a pose graph over submaps from all alignments, with rejection of wrong ones.

Between the submaps of one map odometry holds; it is never doubted. Alignments are: GTSAM's graduated non-convexity with
truncated least squares finds which of them the others contradict (Yang et al., 2020).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import invert
from hickory_stream.graph.factors import tangent_covariance

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

# An alignment that claims less is not believed: maps drift.
_MIN_SIGMA_M, _MIN_SIGMA_RAD = 0.02, np.radians(0.3)
_ODOMETRY_SIGMA_M, _ODOMETRY_SIGMA_RAD = 0.02, np.radians(0.2)
_MIN_WEIGHT = 0.5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Relation:
    """Between two nodes: `a_from_b` (4, 4), the covariance (6, 6) of a turn about `center_a` (3,), then a shift.

    `strength` orders alignments, the strongest first in building the start: minus the logarithm of chance.
    """

    a: int
    b: int
    a_from_b: NDArray[np.float64]
    covariance: NDArray[np.float64]
    center_a: NDArray[np.float64]
    strength: float

    def __post_init__(self) -> None:
        freeze(self, "a_from_b", np.float64, (4, 4))
        freeze(self, "covariance", np.float64, (6, 6))
        freeze(self, "center_a", np.float64, (3,))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Solved:
    """`root_from_node` (4, 4) of each node that hangs on the root, None of the others; which relations are believed."""

    root_from_node: tuple[NDArray[np.float64] | None, ...]
    is_believed: tuple[bool, ...]


def odometry(a: int, b: int, a_from_b: NDArray[np.float64]) -> Relation:
    """Return the relation of two submaps of one map."""
    sigmas = np.array([_ODOMETRY_SIGMA_RAD] * 3 + [_ODOMETRY_SIGMA_M] * 3)
    return Relation(
        a=a, b=b, a_from_b=a_from_b, covariance=np.diag(sigmas**2), center_a=a_from_b[:3, 3], strength=np.inf
    )


def solve(num_nodes: int, odometries: Sequence[Relation], alignments: Sequence[Relation], root: int = 0) -> Solved:
    """Return where the nodes lie in the frame of the root, and which of the alignments are believed."""
    import gtsam

    start = _spanned(num_nodes, odometries, alignments, root)
    graph = gtsam.NonlinearFactorGraph()
    sure = [0]
    graph.add(gtsam.PriorFactorPose3(root, gtsam.Pose3(np.eye(4)), gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    for relation in odometries:
        if start[relation.a] is not None:
            sure.append(graph.size())
            graph.add(_factor(relation))
    used = [i for i, relation in enumerate(alignments) if start[relation.a] is not None]
    first = graph.size()
    for i in used:
        graph.add(_factor(alignments[i]))
    values = gtsam.Values()
    for node, pose in enumerate(start):
        if pose is not None:
            values.insert(node, gtsam.Pose3(pose))
    parameters = gtsam.GncLMParams(gtsam.LevenbergMarquardtParams())
    parameters.setKnownInliers(sure)
    optimizer = gtsam.GncLMOptimizer(graph, values, parameters)
    solution = optimizer.optimize()
    weights = np.asarray(optimizer.getWeights())
    believed = {i for place, i in enumerate(used) if weights[first + place] > _MIN_WEIGHT}
    # Nodes that only a rejected relation connected are no longer connected.
    reached = _spanned(num_nodes, odometries, [alignments[i] for i in sorted(believed)], root)
    return Solved(
        root_from_node=tuple(
            np.asarray(solution.atPose3(node).matrix()) if reached[node] is not None else None
            for node in range(num_nodes)
        ),
        is_believed=tuple(i in believed and reached[relation.a] is not None for i, relation in enumerate(alignments)),
    )


def _factor(relation: Relation) -> Any:
    import gtsam

    floor = np.diag([_MIN_SIGMA_RAD**2] * 3 + [_MIN_SIGMA_M**2] * 3)
    covariance = tangent_covariance(relation.a_from_b, relation.covariance + floor, relation.center_a)
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.BetweenFactorPose3(relation.a, relation.b, gtsam.Pose3(relation.a_from_b), noise)


def _spanned(
    num_nodes: int, odometries: Sequence[Relation], alignments: Sequence[Relation], root: int
) -> list[NDArray[np.float64] | None]:
    """Return the poses along the tree of the strongest relations from the root; None for what it does not reach."""
    poses: list[NDArray[np.float64] | None] = [None] * num_nodes
    poses[root] = np.eye(4)
    ordered = sorted([*odometries, *alignments], key=lambda relation: -relation.strength)
    while True:
        for relation in ordered:
            pose_a, pose_b = poses[relation.a], poses[relation.b]
            if pose_a is not None and pose_b is None:
                poses[relation.b] = pose_a @ relation.a_from_b
                break
            if pose_b is not None and pose_a is None:
                poses[relation.a] = pose_b @ invert(relation.a_from_b)
                break
        else:
            return poses
