"""The solver: which loops are believed, and where the nodes lie, computed anew from the factors alone.

1. A loop that odometry, as uncertain as it is, cannot explain is impossible (`gate.py`).
2. The others are judged by graduated non-convexity with truncated least squares (Yang et al., RA-L 2020), as GTSAM has
   it, on the skeleton of the graph: the nodes at which loops end, and odometry with verticals composed between them.
   Of those that it gives up, the ones that no believed loop speaks against are believed.
3. All nodes are placed by least squares over odometry, verticals and the believed loops.

Only loops are ever cut, as in Kimera-RPGO: were edges of odometry cut alike, each wrong loop could be had by cutting
one. None is certain either: each stretches as far as its covariance says, and one that jumped nearly as it likes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.errors import GraphError
from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import invert
from hickory_stream.graph.chain import Chain
from hickory_stream.graph.config import GraphConfig
from hickory_stream.graph.factors import adjoint, symmetric
from hickory_stream.graph.gate import surprise_of
from hickory_stream.graph.gtsam_solver import Factors, poses_of, settled
from hickory_stream.graph.solution import NoSolution, RejectedLoop, Solution

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.graph.factors import LoopEdge, PoseGraph

_BELIEVED = 0.5
_SAME_CHI2 = 0.01
"""Squared distances that differ by less are the same: what rounding leaves where loops do not concern one another."""

# A loop is impossible above this squared Mahalanobis distance from the odometry's prediction: 99.9 % of chi-squared
# with 6 degrees of freedom.
GATE_CHI2 = 22.46
# A loop is contradicted if its residual in the solution is above this: 99 % of chi-squared.
INLIER_CHI2 = 16.81


def solve(
    graph: PoseGraph, config: GraphConfig | None = None, *, accepted_before: Collection[int] = ()
) -> Solution | NoSolution:
    """Return where the nodes lie and which loops are believed; the same factors give the same bytes.

    Without a loop that is believed the poses are those of the graph, to the last bit.

    Args:
        graph: the factors.
        config: when a loop is believed.
        accepted_before: ids of loops that an earlier solution had accepted; those not believed now are withdrawn.
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


def node_covariances(graph: PoseGraph, solution: Solution) -> NDArray[np.float64]:
    """Return (N, 6, 6) how uncertain each node is relative to node 0 in a solution, in the node's frame.

    Raises:
        GraphError: the solution is not one of this graph.
    """
    marginals = _marginals(graph, solution)
    return np.array([symmetric(marginals.marginalCovariance(i)) for i in range(graph.num_nodes)])


def relative_covariances(graph: PoseGraph, solution: Solution, pairs: Sequence[tuple[int, int]]) -> NDArray[np.float64]:
    """Return (P, 6, 6) how uncertain `a_from_b` of each pair of nodes (a, b) is in a solution, in the frame of b.

    Raises:
        GraphError: the solution is not one of this graph.
    """
    marginals = _marginals(graph, solution)
    return np.array([_relative(marginals, solution.world_from_node, a, b) for a, b in pairs]).reshape(-1, 6, 6)


# ---- the steps ------------------------------------------------------------------------------------------------------


def _possible(graph: PoseGraph, chain: Chain) -> tuple[list[LoopEdge], dict[int, str]]:
    """Return the loops that odometry allows, and why not of each other one."""
    possible, reasons = [], {}
    predictions = chain.predictions([(loop.earlier, loop.later) for loop in graph.loops])
    for loop, prediction in zip(graph.loops, predictions, strict=True):
        surprise = surprise_of(loop, prediction)
        if surprise.chi2 <= GATE_CHI2:
            possible.append(loop)
        else:
            reasons[loop.id] = (
                f"impossible: {surprise.distance_m:.2f} m and {np.degrees(surprise.angle_rad):.1f} deg from where "
                f"odometry predicts it (chi2 {surprise.chi2:.0f}, at most {GATE_CHI2:g})"
            )
    return possible, reasons


def _judged(chain: Chain, loops: Sequence[LoopEdge]) -> tuple[list[float], NDArray[np.float64]]:
    """Return the weight, 0..1, of each loop, and about where (N, 4, 4) all nodes lie by them."""
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
    """Return the weights (K,), 1 for each loop left out that no believed loop speaks against.

    Graduated non-convexity gives next to no weight at first to a loop for which odometry must stretch far, and where
    hardly any other loop helps that weight never grows, although the gate has allowed the stretch. What contradicts a
    loop are others: those believed make it more surprising than it is to odometry alone. One that they do not is
    believed, what fits them best first.
    """
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
    """Return the solution over the loops of some weight; those beyond the limit in it are left out, the worst first.

    The skeleton is the whole graph to first order only, so that a loop at the limit there may be beyond it here.
    """
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
    accepted = tuple(sorted(loop.id for loop in believed))
    contradicted = {loop.id: "contradicted by odometry and other loops" for loop in possible if loop not in believed}
    weight_of = {loop.id: weight for loop, weight in zip(possible, weights, strict=True)}
    return Solution(
        world_from_node=poses,
        loop_weights=np.array([weight_of.get(loop.id, 0.0) for loop in graph.loops]),
        accepted=accepted,
        rejected=tuple(
            RejectedLoop(id=i, status="withdrawn" if i in accepted_before else "rejected", reason=reason)
            for i, reason in sorted({**reasons, **contradicted}.items())
        ),
        chi2=factors.total_chi2(values),
        dof=6 * len(believed) + 2 * (graph.num_nodes - 1),
    )


def _whole(graph: PoseGraph, loops: Sequence[LoopEdge], start: NDArray[np.float64]) -> tuple[Factors, list[int]]:
    """Return all factors of a graph with these loops, and the places of the loops."""
    factors = Factors()
    factors.add_nodes(range(graph.num_nodes), start)
    factors.add_verticals(range(1, graph.num_nodes), graph.world_from_node, graph.gravity_sigma_rad)
    for edge in graph.odometry:
        factors.add_odometry(edge)
    return factors, [factors.add_loop(loop) for loop in loops]


def _marginals(graph: PoseGraph, solution: Solution) -> Any:
    believed = [loop for loop in graph.loops if loop.id in set(solution.accepted)]
    factors, _ = _whole(graph, believed, solution.world_from_node)
    try:
        return factors.marginals(factors.values)
    except RuntimeError as error:
        raise GraphError(f"the solution does not determine all nodes of the graph: {error}") from error


def _relative(marginals: Any, world_from_node: NDArray[np.float64], a: int, b: int) -> NDArray[np.float64]:
    if a == b:
        return np.zeros((6, 6))
    joint = marginals.jointMarginalCovariance([a, b])
    carry = adjoint(portable.matmul(invert(world_from_node[b]), world_from_node[a]))
    across = portable.matmul(carry, joint.at(a, b))
    own = portable.matmul(portable.matmul(carry, joint.at(a, a)), carry.T)
    return symmetric(own + joint.at(b, b) - across - across.T)
