"""The public record of a pose graph and its solution: for the map folder, pictures and viewers."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import invert
from hickory_stream.graph.factors import PoseGraph
from hickory_stream.graph.gate import difference
from hickory_stream.graph.solution import Solution
from hickory_stream.graph.solve import node_covariances
from hickory_stream.records import GraphEdge, GraphNode, PoseGraphRecord

# Far below what matters, far above the last bits in which kinds of processor may differ.
_DIGITS = 6


def record_of(
    graph: PoseGraph, solution: Solution, submap_ids: Sequence[int], stamps_ns: Sequence[int]
) -> PoseGraphRecord:
    """Return the record of a graph and its solution, by the ascending id and the opening stamp of each node's submap.

    An edge of odometry has the stamp of its later node.
    """
    covariances = node_covariances(solution)
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

    def edge_of(earlier: int, later: int, earlier_from_later: NDArray[np.float64], **more: Any) -> GraphEdge:
        poses = solution.world_from_node
        error = difference(earlier_from_later, portable.matmul(invert(poses[earlier]), poses[later]))
        residual_m, residual_rad = _rounded(portable.norm(error[3:])), _rounded(portable.norm(error[:3]))
        first, last = submap_ids[earlier], submap_ids[later]
        return GraphEdge(earlier=first, later=last, residual_m=residual_m, residual_rad=residual_rad, **more)

    edges = []
    for edge in graph.odometry:
        reason, stamp_ns = "the odometry jumped" if edge.is_jump else "", stamps_ns[edge.after]
        own: dict[str, Any] = {"kind": "odometry", "status": "accepted", "score": None}
        edges.append(edge_of(edge.before, edge.after, edge.before_from_after, reason=reason, stamp_ns=stamp_ns, **own))
    rejected = {loop.id: (loop.status, loop.reason) for loop in solution.rejected}
    for loop in graph.loops:
        status, reason = rejected.get(loop.id, ("accepted", ""))
        own = {"kind": "loop", "status": status, "score": loop.score, "reason": reason}
        edges.append(edge_of(loop.earlier, loop.later, loop.earlier_from_later, stamp_ns=loop.stamp_ns, **own))
    return PoseGraphRecord(nodes=nodes, edges=tuple(edges))


def _in_the_plane(world_from_node: NDArray[np.float64], covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    # (2, 2) of a place along the world's x and y, from (6, 6) in the frame of the node.
    rotation = world_from_node[:3, :3]
    along = portable.matmul(portable.matmul(rotation, covariance[3:, 3:]), rotation.T)
    return np.round(along[:2, :2], 2 * _DIGITS)


def _rounded(value: float) -> float:
    return round(float(value), _DIGITS)
