"""What odometry alone says between any two nodes: its edges along the way from one to the other, errors added up.

Independent errors of edges in a row add up once all are seen from one frame; to first order this is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import invert

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from hickory_stream.graph.factors import PoseGraph


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prediction:
    """What odometry says of two nodes: `earlier_from_later` (4, 4), and its covariance (6, 6) in the later's frame."""

    earlier_from_later: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Link:
    """Odometry composed between two nodes: `before_from_after` (4, 4), its covariance (6, 6) in the later's frame."""

    before: int
    after: int
    before_from_after: NDArray[np.float64]
    covariance: NDArray[np.float64]


class Chain:
    """The tree of a graph's odometry.

    `world_from_node` (N, 4, 4) are the poses that its edges give, from node 0 on.
    """

    def __init__(self, graph: PoseGraph) -> None:
        poses = np.array(graph.world_from_node)
        errors = np.zeros((graph.num_nodes, 6, 6))
        self._before = [-1] * graph.num_nodes
        for edge in sorted(graph.odometry, key=lambda edge: edge.after):
            self._before[edge.after] = edge.before
            poses[edge.after] = portable.matmul(poses[edge.before], edge.before_from_after)
            errors[edge.after] = edge.covariance
        # Of the edge to each node, as small motions in the frame of the world.
        carry = _adjoints(poses[:, :3, :3], poses[:, :3, 3])
        self._errors = portable.matmul(portable.matmul(carry, errors), np.swapaxes(carry, 1, 2))
        turned = np.ascontiguousarray(np.swapaxes(poses[:, :3, :3], 1, 2))
        self._node_from_world = _adjoints(turned, -portable.matmul(turned, poses[:, :3, 3:])[:, :, 0])
        self._upright = graph.world_from_node[:, 2, :3]
        self._gravity_sigma_rad = graph.gravity_sigma_rad
        self.world_from_node = poses

    def predictions(self, pairs: Sequence[tuple[int, int]]) -> list[Prediction]:
        """Return what odometry and the verticals say of pairs of nodes, the earlier first."""
        # The ways from both to the first node, without what they share.
        ways = [sorted(set(self._above(earlier)) ^ set(self._above(later))) for earlier, later in pairs]
        covariances = self._known([later for _, later in pairs], ways)
        return [
            Prediction(earlier_from_later=self._between(earlier, later), covariance=covariance)
            for (earlier, later), covariance in zip(pairs, covariances, strict=True)
        ]

    def skeleton(self, ends: Iterable[int]) -> tuple[Link, ...]:
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
        nodes = sorted(kept - {0})
        ways = [self._up_to(node, kept) for node in nodes]
        befores = [self._before[way[-1]] for way in ways]
        return tuple(
            Link(
                before=before,
                after=after,
                before_from_after=self._between(before, after),
                covariance=covariance,
            )
            for before, after, covariance in zip(befores, nodes, self._known(nodes, ways), strict=True)
        )

    def _up_to(self, node: int, kept: set[int]) -> list[int]:
        """Return a node and those before it, up to the first that hangs on one of `kept`."""
        way = [node]
        while self._before[way[-1]] not in kept:
            way.append(self._before[way[-1]])
        return way

    def _above(self, node: int) -> list[int]:
        """Return a node and those on the way from it to the first."""
        way = []
        while node >= 0:
            way.append(node)
            node = self._before[node]
        return way

    def _between(self, a: int, b: int) -> NDArray[np.float64]:
        return portable.matmul(invert(self.world_from_node[a]), self.world_from_node[b])

    def _known(self, nodes: Sequence[int], ways: Sequence[list[int]]) -> NDArray[np.float64]:
        """Return (K, 6, 6) the covariance of each way, seen from its node, when the verticals at its ends are known.

        A way are the nodes to which its edges lead.
        """
        if not ways:
            return np.empty((0, 6, 6))
        carry = self._node_from_world[nodes]
        summed = np.array([self._errors[way].sum(axis=0) for way in ways])
        covariances = portable.matmul(portable.matmul(carry, summed), np.swapaxes(carry, 1, 2))
        return _with_verticals(covariances, self._upright[nodes], self._gravity_sigma_rad)


def _adjoints(rotations: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `adjoint` (N, 6, 6) of transforms with these rotations (N, 3, 3) and places (N, 3)."""
    x, y, z = places.T
    zero = np.zeros_like(x)
    crosses = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    stack = np.zeros((len(places), 6, 6))
    stack[:, :3, :3] = stack[:, 3:, 3:] = rotations
    stack[:, 3:, :3] = portable.matmul(crosses, rotations)
    return stack


def _with_verticals(
    covariances: NDArray[np.float64], ups: NDArray[np.float64], gravity_sigma_rad: float
) -> NDArray[np.float64]:
    """Return covariances (K, 6, 6) after the verticals at both ends were measured; `ups` (K, 3) is up in each frame.

    A turn about a level axis is then known: two scalar updates, one for each level axis, as a Kalman filter makes them.
    """
    variance = 2.0 * gravity_sigma_rad * gravity_sigma_rad
    first = _unit_crosses(ups, np.eye(3)[np.argmin(np.abs(ups), axis=1)])
    for axes in (first, _unit_crosses(ups, first)):
        across = (covariances[:, :, :3] * axes[:, None, :]).sum(axis=2)
        expected = variance + (axes * across[:, :3]).sum(axis=1)
        covariances = covariances - across[:, :, None] * across[:, None, :] / expected[:, None, None]
    return 0.5 * (covariances + np.swapaxes(covariances, 1, 2))


def _unit_crosses(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    (x, y, z), (u, v, w) = a.T, b.T
    crosses = np.column_stack([y * w - z * v, z * u - x * w, x * v - y * u])
    return crosses / np.sqrt(np.square(crosses).sum(axis=1))[:, None]
