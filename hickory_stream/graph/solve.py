"""The solver: it accepts or rejects loops, and places the nodes, from the factors alone.

1. A loop that odometry, with its uncertainty, cannot explain is impossible (`gate.py`).
2. Graduated non-convexity (Yang et al., RA-L 2020, in GTSAM) judges the others on the skeleton of the graph: the nodes
   of loops, with composed odometry and verticals. A loop that it rejects, but no accepted one contradicts, is accepted.
3. Least squares over odometry, verticals and accepted loops place all nodes.

Only loops are ever cut, as in Kimera-RPGO: else a wrong loop could cut odometry. Edges stretch by their covariance.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import invert
from hickory_stream.graph.chain import Chain
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import LoopEdge, PoseGraph, adjoint
from hickory_stream.graph.gate import surprise_of
from hickory_stream.graph.gtsam_solver import Factors, poses_of, settled
from hickory_stream.graph.solution import NoSolution, RejectedLoop, Solution

_BELIEVED = 0.5
# Squared distances that differ by less are the same: rounding, for loops that do not concern one another.
_SAME_CHI2 = 0.01

# A loop is impossible above this squared Mahalanobis distance from the odometry's prediction: 99.9 % of chi-squared
# with 6 degrees of freedom.
GATE_CHI2 = 22.46
# A loop is contradicted if its residual in the solution is above this: 99 % of chi-squared.
INLIER_CHI2 = 16.81


def solve(
    graph: PoseGraph, config: GraphConfig | None = None, *, accepted_before: Collection[int] = ()
) -> Solution | NoSolution:
    """Return the places of the nodes and the accepted loops; the same factors give the same bytes.

    Without an accepted loop the poses are the graph's, to the last bit. `accepted_before`: ids of loops in an earlier
    solution; those rejected now are withdrawn.
    """
    config = GraphConfig() if config is None else config
    chain = Chain(graph)
    possible, reasons = _possible(graph, chain)
    try:
        weights, start = _judged(chain, possible)
        return _placed(graph, start, possible, weights, reasons, frozenset(accepted_before))
    except RuntimeError as error:
        # GTSAM's exceptions, e.g. of a system without a unique solution, are RuntimeErrors in Python.
        return NoSolution(reason=f"the pose graph could not be solved: {str(error).strip().splitlines()[0]}")


def node_covariances(solution: Solution) -> NDArray[np.float64]:
    """Return (N, 6, 6) the covariance of each node relative to node 0, in its frame."""
    return np.array([solution.marginals.covariance({i: np.eye(6)}) for i in range(len(solution.world_from_node))])


def relative_covariances(solution: Solution, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """Return (P, 6, 6) the covariance of `a_from_b` of pairs (a, b), in the frame of b."""
    world_from = solution.world_from_node
    motions = [_between(world_from, a, b) for a, b in pairs]
    return np.array([solution.marginals.covariance(motion) for motion in motions]).reshape(-1, 6, 6)


def _possible(graph: PoseGraph, chain: Chain) -> tuple[list[LoopEdge], dict[int, str]]:
    # The loops that odometry allows, and the reason against each other one.
    possible, reasons = [], {}
    predictions = chain.predictions([(loop.earlier, loop.later) for loop in graph.loops])
    for loop, prediction in zip(graph.loops, predictions, strict=True):
        surprise = surprise_of(loop, prediction)
        if surprise.chi2 <= GATE_CHI2:
            possible.append(loop)
        else:
            where = f"{surprise.distance_m:.2f} m and {np.degrees(surprise.angle_rad):.1f} deg from where"
            limits = f"(chi2 {surprise.chi2:.0f}, at most {GATE_CHI2:g})"
            reasons[loop.id] = f"impossible: {where} odometry predicts it {limits}"
    return possible, reasons


def _judged(chain: Chain, loops: Sequence[LoopEdge]) -> tuple[list[float], NDArray[np.float64]]:
    # The weight, 0..1, of each loop, and the approximate places (N, 4, 4) of all nodes.
    if not loops:
        return [], chain.world_from_node
    edges = chain.skeleton({node for loop in loops for node in (loop.earlier, loop.later)})
    factors = Factors()
    nodes = (0, *(edge.after for edge in edges))
    factors.add_nodes(nodes, chain.world_from_node)
    for edge in edges:
        factors.add_odometry(edge)
    places = [factors.add_loop(loop) for loop in loops]
    weights, values = factors.judged(places, INLIER_CHI2)
    weights = _reconsidered(factors, places, weights, values)
    return weights.tolist(), chain.carried(dict(zip(nodes, poses_of(values, nodes), strict=True)))


def _reconsidered(
    factors: Factors, places: Sequence[int], weights: NDArray[np.float64], values: Any
) -> NDArray[np.float64]:
    # Graduated non-convexity gives next to no weight to a loop for which odometry must stretch far, without help of
    # other loops, although the gate allows the stretch. Such a loop is accepted, best first, if the accepted ones do
    # not make it more surprising than odometry alone.
    believed = weights > _BELIEVED
    doubted = np.flatnonzero(~believed)
    if len(doubted) == 0:
        return weights

    def surprises(asked: Iterable[int], left_out: Iterable[int]) -> NDArray[np.float64]:
        return factors.surprises([places[i] for i in asked], {places[i] for i in left_out}, values)

    most = surprises(doubted, range(len(places))) + _SAME_CHI2
    together = surprises(doubted, doubted)
    for k in np.argsort(together, kind="stable"):
        if together[k] <= most[k]:
            left_out = np.flatnonzero(~believed)
            believed[doubted[k]] = surprises([doubted[k]], left_out)[0] <= most[k]
    return np.where(believed, 1.0, weights)


def _placed(
    graph: PoseGraph,
    start: NDArray[np.float64],
    possible: Sequence[LoopEdge],
    weights: Sequence[float],
    reasons: Mapping[int, str],
    accepted_before: frozenset[int],
) -> Solution | NoSolution:
    # The skeleton is the whole graph to first order only, so loops beyond the limit here are cut, the worst first.
    believed = [loop for loop, weight in zip(possible, weights, strict=True) if weight > _BELIEVED]
    while True:
        factors, places = _whole(graph, believed, start)
        values = factors.optimized() if believed else factors.values
        residuals = [factors.chi2(place, values) for place in places]
        if max(residuals, default=0.0) <= INLIER_CHI2:
            break
        del believed[int(np.argmax(residuals))]
    poses = settled(values, range(graph.num_nodes)) if believed else np.array(graph.world_from_node)
    poses[0] = graph.world_from_node[0]
    if not np.isfinite(poses).all():
        return NoSolution(reason="the pose graph could not be solved: its solution is not finite")
    contradicted = {loop.id: "contradicted by odometry and other loops" for loop in possible if loop not in believed}
    against = sorted({**reasons, **contradicted}.items())
    weight_of = {loop.id: weight for loop, weight in zip(possible, weights, strict=True)}
    return Solution(
        world_from_node=poses,
        loop_weights=np.array([weight_of.get(loop.id, 0.0) for loop in graph.loops]),
        accepted=tuple(sorted(loop.id for loop in believed)),
        rejected=tuple(
            RejectedLoop(id=i, status="withdrawn" if i in accepted_before else "rejected", reason=reason)
            for i, reason in against
        ),
        marginals=factors.marginals(poses),
        chi2=factors.total_chi2(values),
        dof=6 * len(believed) + 2 * (graph.num_nodes - 1),
    )


def _whole(graph: PoseGraph, loops: Sequence[LoopEdge], start: NDArray[np.float64]) -> tuple[Factors, list[int]]:
    factors = Factors()
    factors.add_nodes(range(graph.num_nodes), start)
    factors.add_verticals(range(1, graph.num_nodes), graph.world_from_node, graph.gravity_sigma_rad)
    for edge in graph.odometry:
        factors.add_odometry(edge)
    return factors, [factors.add_loop(loop) for loop in loops]


def _between(world_from_node: NDArray[np.float64], a: int, b: int) -> dict[int, NDArray[np.float64]]:
    if a == b:
        return {}
    b_from_a = portable.matmul(invert(world_from_node[b]), world_from_node[a])
    return {a: -adjoint(b_from_a), b: np.eye(6)}
