"""The public record of a pose graph and its solution: for the map folder, pictures and viewers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import invert
from hickory_stream.graph.gate import difference
from hickory_stream.graph.solve import node_covariances
from hickory_stream.records import GraphEdge, GraphNode, PoseGraphRecord

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.graph.factors import PoseGraph
    from hickory_stream.graph.solution import Solution

# Far below what matters, far above the last bits in which kinds of processor may differ.
_DIGITS = 6


def record_of(
    graph: PoseGraph, solution: Solution, submap_ids: Sequence[int], stamps_ns: Sequence[int]
) -> PoseGraphRecord:
    """Return the record of a graph and its solution.

    Args:
        graph: the factors.
        solution: what `solve` answered for them.
        submap_ids: the submap that each node is, ascending.
        stamps_ns: when each submap was opened; an edge of odometry has the stamp of its later node.

    Raises:
        GraphError: the solution is not one of this graph.
    """
    covariances = node_covariances(graph, solution)
    variances = covariances.diagonal(axis1=1, axis2=2)
    nodes = tuple(
        GraphNode(
            submap_id=submap_id,
            stamp_ns=stamp_ns,
            place=solution.world_from_node[i],
            uncorrected=graph.world_from_node[i],
            sigma_m=_rounded(np.sqrt(variances[i, 3:].sum())),
            sigma_rad=_rounded(np.sqrt(variances[i, :3].sum())),
            covariance_xy=_in_the_plane(solution.world_from_node[i], covariances[i]),
        )
        for i, (submap_id, stamp_ns) in enumerate(zip(submap_ids, stamps_ns, strict=True))
    )
    edges = []
    for edge in graph.odometry:
        residual_m, residual_rad = _residual(solution, edge.before, edge.after, edge.before_from_after)
        edges.append(
            GraphEdge(
                kind="odometry",
                earlier=submap_ids[edge.before],
                later=submap_ids[edge.after],
                status="accepted",
                score=None,
                reason="the odometry jumped" if edge.is_jump else "",
                residual_m=residual_m,
                residual_rad=residual_rad,
                stamp_ns=stamps_ns[edge.after],
            )
        )
    refused = {loop.id: loop for loop in solution.rejected}
    for loop in graph.loops:
        residual_m, residual_rad = _residual(solution, loop.earlier, loop.later, loop.earlier_from_later)
        told = refused.get(loop.id)
        edges.append(
            GraphEdge(
                kind="loop",
                earlier=submap_ids[loop.earlier],
                later=submap_ids[loop.later],
                status="accepted" if told is None else told.status,
                score=loop.score,
                reason="" if told is None else told.reason,
                residual_m=residual_m,
                residual_rad=residual_rad,
                stamp_ns=loop.stamp_ns,
            )
        )
    return PoseGraphRecord(nodes=nodes, edges=tuple(edges))


def _residual(
    solution: Solution, first: int, second: int, first_from_second: NDArray[np.float64]
) -> tuple[float, float]:
    """Return how far the solution is from what an edge says: metres and radians."""
    poses = solution.world_from_node
    error = difference(first_from_second, portable.matmul(invert(poses[first]), poses[second]))
    return _rounded(portable.norm(error[3:])), _rounded(portable.norm(error[:3]))


def _in_the_plane(world_from_node: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the covariance (2, 2) of a place along the world's x and y, from that in the frame of the node."""
    rotation = world_from_node[:3, :3]
    along = portable.matmul(portable.matmul(rotation, covariance[3:, 3:]), rotation.T)
    return np.round(along[:2, :2], 2 * _DIGITS)


def _rounded(value: float) -> float:
    return round(float(value), _DIGITS)
