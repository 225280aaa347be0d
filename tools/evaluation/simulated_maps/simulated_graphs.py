"""Pose graphs of a long walk with known truth: odometry that drifts, loops, and wrong loops among them."""
# Wrong loops are of three kinds in turn: a look-alike elsewhere, a place off by a shelf or a desk, one turned by half a
# turn.

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import (
    from_rotation_translation,
    invert,
    rotation_angle_rad,
    rotation_of_vector,
    yaw_rotation,
)
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import LoopEdge, OdometryEdge, PoseGraph, odometry_covariance
from tools.worlds.drift import drift_of, drifted_poses

NODE_STEP_M, NODE_STEP_NS = 3.0, 5_000_000_000
_ROUTE = np.array([[0, 0], [12, 0], [12, 8], [6, 8], [6, 16], [0, 16], [0, 8], [-6, 8], [-6, 0]], dtype=np.float64)
_LOOP_SIGMA_M, _LOOP_SIGMA_RAD = 0.03, 0.01
_NEAR_M, _FAR_M, _LEAST_GAP = 3.0, 6.0, 10


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SimulatedGraph:
    """A graph, the true poses (N, 4, 4) of its nodes in the frame of the first, and the ids of its wrong loops."""

    graph: PoseGraph
    true: NDArray[np.float64]
    wrong: frozenset[int]


def simulated_graph(
    rng: np.random.Generator, config: GraphConfig, *, num_nodes: int = 300, num_loops: int = 40, num_wrong: int = 4,
    drift: float = 1.0, start_ns: int = 0,
) -> SimulatedGraph:  # fmt: skip
    """Return a graph; `drift` multiplies the drift of `tools.worlds.drift`."""
    # A loop is found when its later node is, and a node is every five seconds from `start_ns` on.
    true = _walked(num_nodes)
    poses = drifted_poses(true, drift_of(drift), rng)
    odometry = tuple(
        OdometryEdge(
            before=i - 1,
            after=i,
            before_from_after=invert(poses[i - 1]) @ poses[i],
            covariance=odometry_covariance(NODE_STEP_M, turn_rad, config),
        )
        for i in range(1, num_nodes)
        for turn_rad in [rotation_angle_rad(true[i - 1, :3, :3].T @ true[i, :3, :3])]
    )
    gap = np.linalg.norm(true[:, None, :3, 3] - true[None, :, :3, 3], axis=2)
    later, earlier = np.tril_indices(num_nodes, -_LEAST_GAP)
    near = np.flatnonzero(gap[later, earlier] < _NEAR_M)
    far = np.flatnonzero(gap[later, earlier] > _FAR_M)
    is_wrong = np.zeros(num_loops, dtype=bool)
    is_wrong[rng.choice(num_loops, num_wrong, replace=False)] = True
    loops = []
    for i, wrong in enumerate(is_wrong):
        kind = int(is_wrong[:i].sum()) % 3 if wrong else None
        k = int(rng.choice(far if kind == 0 else near))
        a, b = int(earlier[k]), int(later[k])
        loops.append(_loop(i, a, b, true, kind, start_ns, rng))
    graph = PoseGraph(world_from_node=poses, odometry=odometry, loops=tuple(loops), gravity_sigma_rad=0.02)
    return SimulatedGraph(graph=graph, true=true, wrong=frozenset(np.flatnonzero(is_wrong).tolist()))


def _walked(num_nodes: int) -> NDArray[np.float64]:
    ends = np.concatenate([_ROUTE, _ROUTE[:1]])
    lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    poses = []
    for way_m in np.arange(num_nodes) * NODE_STEP_M % marks[-1]:
        leg = int(np.searchsorted(marks, way_m, side="right")) - 1
        forward = (ends[leg + 1] - ends[leg]) / lengths[leg]
        place = ends[leg] + (way_m - marks[leg]) * forward
        poses.append(
            from_rotation_translation(yaw_rotation(float(np.arctan2(forward[1], forward[0]))), np.array([*place, 0.0]))
        )
    return invert(poses[0]) @ np.array(poses)


def _loop(
    number: int, a: int, b: int, true: NDArray[np.float64], kind: int | None, start_ns: int, rng: np.random.Generator
) -> LoopEdge:
    a_from_b = invert(true[a]) @ true[b]
    if kind == 0:
        a_from_b = from_rotation_translation(yaw_rotation(rng.normal(0, 0.5)), np.array([*rng.normal(0, 1.0, 2), 0.0]))
    elif kind == 1:
        along = rng.choice([-1, 1]) * np.eye(3)[rng.integers(2)] * rng.uniform(0.8, 2.0)
        a_from_b = from_rotation_translation(np.eye(3), along) @ a_from_b
    elif kind == 2:
        a_from_b = from_rotation_translation(yaw_rotation(np.pi), np.array([*rng.normal(0, 1.0, 2), 0.0])) @ a_from_b
    noise = from_rotation_translation(
        rotation_of_vector(rng.normal(0, _LOOP_SIGMA_RAD, 3)), rng.normal(0, _LOOP_SIGMA_M, 3)
    )
    return LoopEdge(
        id=number, earlier=a, later=b, earlier_from_later=a_from_b @ noise,
        covariance=np.diag([_LOOP_SIGMA_RAD**2] * 3 + [_LOOP_SIGMA_M**2] * 3), method="surface",
        score=float(rng.uniform(5, 30)), stamp_ns=start_ns + b * NODE_STEP_NS,
    )  # fmt: skip
