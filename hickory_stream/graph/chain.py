"""What odometry alone says between any two nodes: its edges along the way from one to the other, errors added up.

Independent errors of edges in a row add up once all are seen from one frame; to first order this is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import invert
from hickory_stream.graph.factors import OdometryEdge, adjoint, symmetric

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hickory_stream.graph.factors import PoseGraph


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prediction:
    """What odometry says of two nodes: `earlier_from_later` (4, 4), and its covariance (6, 6) in the later's frame."""

    earlier_from_later: NDArray[np.float64]
    covariance: NDArray[np.float64]


class Chain:
    """The tree of a graph's odometry.

    `world_from_node` (N, 4, 4) are the poses that its edges give, from node 0 on.
    """

    def __init__(self, graph: PoseGraph) -> None:
        poses = np.array(graph.world_from_node)
        errors = np.zeros((graph.num_nodes, 6, 6))
        self._before = [-1] * graph.num_nodes
        self._is_jump = [False] * graph.num_nodes
        for edge in sorted(graph.odometry, key=lambda edge: edge.after):
            self._before[edge.after] = edge.before
            self._is_jump[edge.after] = edge.is_jump
            poses[edge.after] = portable.matmul(poses[edge.before], edge.before_from_after)
            errors[edge.after] = edge.covariance
        carried = _adjoints(poses)
        # Of the edge to each node, as small motions in the frame of the world.
        self._errors = portable.matmul(portable.matmul(carried, errors), np.swapaxes(carried, 1, 2))
        self._upright = graph.world_from_node[:, 2, :3]
        self._gravity_sigma_rad = graph.gravity_sigma_rad
        self.world_from_node = poses

    def predicted(self, earlier: int, later: int) -> Prediction:
        """Return what odometry and the verticals say of two nodes."""
        # The ways from both to the first node, without what they share.
        way = sorted(set(self._above(earlier)) ^ set(self._above(later)))
        return Prediction(earlier_from_later=self._between(earlier, later), covariance=self._known(later, way))

    def skeleton(self, ends: Iterable[int]) -> tuple[OdometryEdge, ...]:
        """Return what odometry and the verticals say between the nodes that matter, each after the one it hangs on.

        These are node 0, the nodes `ends`, and those at which the ways to them part; edges have their numbers.
        """
        kept = {0} | set(ends)
        passed: set[int] = set()
        for end in sorted(kept):
            for node in self._above(end):
                if node in passed:
                    kept.add(node)
                    break
                passed.add(node)
        return tuple(self._composed(node, kept) for node in sorted(kept - {0}))

    def _composed(self, after: int, kept: set[int]) -> OdometryEdge:
        way, before = [after], self._before[after]
        while before not in kept:
            way.append(before)
            before = self._before[before]
        return OdometryEdge(
            before=before,
            after=after,
            before_from_after=self._between(before, after),
            covariance=self._known(after, way),
            is_jump=any(self._is_jump[node] for node in way),
        )

    def _above(self, node: int) -> list[int]:
        """Return a node and those on the way from it to the first."""
        way = []
        while node >= 0:
            way.append(node)
            node = self._before[node]
        return way

    def _between(self, a: int, b: int) -> NDArray[np.float64]:
        return portable.matmul(invert(self.world_from_node[a]), self.world_from_node[b])

    def _known(self, node: int, way: list[int]) -> NDArray[np.float64]:
        """Return the covariance (6, 6) of a way to a node, in its frame, when the verticals at both ends are known."""
        return _with_vertical(self._seen_from(node, way), self._upright[node], self._gravity_sigma_rad)

    def _seen_from(self, node: int, way: list[int]) -> NDArray[np.float64]:
        """Return the summed covariance (6, 6) of the edges that lead to the nodes of a way, in the frame of a node."""
        carry = adjoint(invert(self.world_from_node[node]))
        return symmetric(portable.matmul(portable.matmul(carry, self._errors[way].sum(axis=0)), carry.T))


def _adjoints(world_from_node: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `adjoint` (N, 6, 6) of poses (N, 4, 4)."""
    rotations, (x, y, z) = world_from_node[:, :3, :3], world_from_node[:, :3, 3].T
    zero = np.zeros_like(x)
    crosses = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    stack = np.zeros((len(world_from_node), 6, 6))
    stack[:, :3, :3] = stack[:, 3:, 3:] = rotations
    stack[:, 3:, :3] = portable.matmul(crosses, rotations)
    return stack


def _with_vertical(
    covariance: NDArray[np.float64], up: NDArray[np.float64], gravity_sigma_rad: float
) -> NDArray[np.float64]:
    """Return a covariance (6, 6) after the verticals of both nodes were measured; `up` (3,) is that of the frame.

    A turn about a level axis is then known: two scalar updates, one for each level axis, as a Kalman filter makes them.
    """
    variance = 2.0 * gravity_sigma_rad * gravity_sigma_rad
    first = _unit_cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    for axis in (first, _unit_cross(up, first)):
        across = portable.matmul(covariance[:, :3], axis)
        expected = variance + portable.dot(axis, across[:3])
        covariance = covariance - across[:, None] * across[None, :] / expected
    return symmetric(covariance)


def _unit_cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    # Of two vectors np.cross takes ten times as long.
    (x, y, z), (u, v, w) = a, b
    cross = np.array([y * w - z * v, z * u - x * w, x * v - y * u])
    return cross / portable.norm(cross)
