"""Where several maps lie in one frame: a pose graph over their submaps from the alignments of each two."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.answer import Alignment
from hickory_stream.geometry.rigid import invert
from hickory_stream.merging.graph import Relation, odometry, solve

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.alignment.answer import NoAlignment
    from hickory_stream.records import MapSnapshot

    Answers = Mapping[tuple[int, int], Alignment | NoAlignment]


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
    """Return where the maps lie of which the most hang together, in the frame of the first of them, and what of pairs.

    Where as many hang together elsewhere, those with the lowest index are taken. All others are None.
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
    """Return where every map (4, 4) lies in the frame of the root, None where it hangs not on it, and what of pairs.

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
    """Return an alignment as a relation between the first submaps of two maps."""
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
