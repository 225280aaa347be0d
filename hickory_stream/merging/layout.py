"""Where several maps lie in one frame: a pose graph over their submaps from the alignments of each two."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.geometry.arrays import freeze_all
from hickory_stream.geometry.rigid import invert
from hickory_stream.graph.factors import tangent_covariance
from hickory_stream.records import MapSnapshot

Answers = Mapping[tuple[int, int], Alignment | NoAlignment]

# An alignment that claims less is not believed: maps drift.
_MIN_SIGMA_M, _MIN_SIGMA_RAD = 0.02, np.radians(0.3)
_ODOMETRY_SIGMA_M, _ODOMETRY_SIGMA_RAD = 0.02, np.radians(0.2)
_MIN_WEIGHT = 0.5


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Relation:
    """Between two nodes: `a_from_b` (4, 4), the covariance (6, 6) of a turn about `center_a` (3,), then a shift."""

    a: int
    b: int
    a_from_b: NDArray[np.float64]
    covariance: NDArray[np.float64]
    center_a: NDArray[np.float64]
    #: minus the logarithm of chance; the strongest come first in building the start
    strength: float

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, a_from_b=(4, 4), covariance=(6, 6), center_a=(3,))


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
    # Poses along the tree of the strongest relations from the root; None for nodes that it does not reach.
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


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PairOutcome:
    """What became of two maps: the answer of `align`; `is_believed`: it was an alignment that the others bear out."""

    a: int
    b: int
    answer: Alignment | NoAlignment
    is_believed: bool


def largest_layout(
    snapshots: Sequence[MapSnapshot], answers: Answers
) -> tuple[tuple[NDArray[np.float64] | None, ...], tuple[PairOutcome, ...]]:
    """Return where the maps of the largest connected set lie, in the frame of its first, and the outcomes.

    Other maps are None. Of equally large sets, that with the lowest index is taken.
    """
    remaining, found = list(range(len(snapshots))), []
    believed: set[tuple[int, int]] = set()
    while remaining:
        poses, outcomes = laid_out(snapshots, answers, remaining[0])
        found.append(poses)
        believed |= {(pair.a, pair.b) for pair in outcomes if pair.is_believed}
        remaining = [i for i in remaining if poses[i] is None]
    largest = max(found, key=lambda poses: sum(pose is not None for pose in poses))
    return largest, tuple(replace(pair, is_believed=(pair.a, pair.b) in believed) for pair in outcomes)


def laid_out(
    snapshots: Sequence[MapSnapshot], answers: Answers, root: int = 0
) -> tuple[tuple[NDArray[np.float64] | None, ...], tuple[PairOutcome, ...]]:
    """Return where every map (4, 4) lies in the frame of the root, None if not connected with it; and the outcomes.

    A map's frame is that of its first submap; the others hang on it by odometry.
    """
    first_node, nodes = [], 0
    odometries = []
    for snapshot in snapshots:
        first_node.append(nodes)
        poses = [submap.world_from_submap for submap in snapshot.submaps] or [np.eye(4)]
        odometries += [
            odometry(nodes + i - 1, nodes + i, invert(poses[i - 1]) @ poses[i]) for i in range(1, len(poses))
        ]
        nodes += len(poses)
    aligned = [(pair, answer) for pair, answer in answers.items() if isinstance(answer, Alignment)]
    alignments = [
        _relation(snapshots, pair, answer, (first_node[pair[0]], first_node[pair[1]])) for pair, answer in aligned
    ]
    solved = solve(nodes, odometries, alignments, first_node[root])
    believed = {pair for (pair, _), holds in zip(aligned, solved.is_believed, strict=True) if holds}
    poses_of_maps: list[NDArray[np.float64] | None] = []
    root_from_first = _first_pose(snapshots[root])
    for snapshot, node in zip(snapshots, first_node, strict=True):
        pose = solved.root_from_node[node]
        poses_of_maps.append(None if pose is None else root_from_first @ pose @ invert(_first_pose(snapshot)))
    outcomes = tuple(
        PairOutcome(a=a, b=b, answer=answer, is_believed=(a, b) in believed) for (a, b), answer in answers.items()
    )
    return tuple(poses_of_maps), outcomes


def _relation(
    snapshots: Sequence[MapSnapshot], pair: tuple[int, int], answer: Alignment, nodes: tuple[int, int]
) -> Relation:
    pose_a, pose_b = (_first_pose(snapshots[i]) for i in pair)
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = pose_a[:3, :3].T
    return Relation(
        a=nodes[0],
        b=nodes[1],
        a_from_b=invert(pose_a) @ answer.a_from_b @ pose_b,
        covariance=turn @ answer.covariance @ turn.T,
        center_a=pose_a[:3, :3].T @ (answer.center_a - pose_a[:3, 3]),
        strength=-answer.log10_chance,
    )


def _first_pose(snapshot: MapSnapshot) -> NDArray[np.float64]:
    return snapshot.submaps[0].world_from_submap if snapshot.submaps else np.eye(4)
