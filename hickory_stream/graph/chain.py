"""Odometry between any two nodes of a graph: composed edges, with added errors.

Independent errors of edges add up in one frame, exactly to first order. The errors of a path are those from the first
node to its two ends, without the shared part.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.graph.factors import PoseGraph


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Prediction:
    """The odometry between two nodes: `earlier_from_later` (4, 4), and its covariance (6, 6) in the later's frame."""

    earlier_from_later: NDArray[np.float64]
    covariance: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Link:
    """Composed odometry between two nodes: `before_from_after` (4, 4), its covariance (6, 6) in the later's frame."""

    before: int
    after: int
    before_from_after: NDArray[np.float64]
    covariance: NDArray[np.float64]


class Chain:
    """The tree of a graph's odometry; `world_from_node` (N, 4, 4) are the poses by its edges, from node 0 on."""

    def __init__(self, graph: PoseGraph) -> None:
        poses = np.array(graph.world_from_node)
        errors = np.zeros((graph.num_nodes, 6, 6))
        self._before = [0] * graph.num_nodes
        for edge in sorted(graph.odometry, key=lambda edge: edge.after):
            self._before[edge.after] = edge.before
            poses[edge.after] = portable.matmul(poses[edge.before], edge.before_from_after)
            errors[edge.after] = edge.covariance
        # Of the edge to each node, as small motions in the frame of the world.
        carry = _adjoints(poses[:, :3, :3], poses[:, :3, 3])
        self._errors = portable.matmul(portable.matmul(carry, errors), np.swapaxes(carry, 1, 2))
        for node in range(1, graph.num_nodes):
            self._errors[node] += self._errors[self._before[node]]
        self._node_from_world = np.tile(np.eye(4), (graph.num_nodes, 1, 1))
        self._node_from_world[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
        self._node_from_world[:, :3, 3:] = -portable.matmul(self._node_from_world[:, :3, :3], poses[:, :3, 3:])
        self._upright = graph.world_from_node[:, 2, :3]
        self._gravity_sigma_rad = graph.gravity_sigma_rad
        self.world_from_node = poses

    def predictions(self, pairs: Sequence[tuple[int, int]]) -> list[Prediction]:
        """Return the predictions of odometry and verticals for pairs of nodes, the earlier first."""
        earlier, later = [a for a, _ in pairs], [b for _, b in pairs]
        shared = [self._meeting(a, b) for a, b in pairs]
        summed = self._errors[earlier] + self._errors[later] - 2.0 * self._errors[shared]
        between = self._between(earlier, later)
        return [
            Prediction(earlier_from_later=transform, covariance=covariance)
            for transform, covariance in zip(between, self._known(later, summed), strict=True)
        ]

    def skeleton(self, ends: Iterable[int]) -> tuple[Link, ...]:
        """Return composed odometry with verticals between node 0, `ends`, and the nodes where their paths part."""
        kept = {0} | set(ends)
        passed: set[int] = set()
        for node in sorted(kept):
            while node > 0 and node not in passed:
                passed.add(node)
                node = self._before[node]
            kept.add(node)
        nodes = sorted(kept - {0})
        befores = [self._up_to(node, kept) for node in nodes]
        between = self._between(befores, nodes)
        covariances = self._known(nodes, self._errors[nodes] - self._errors[befores])
        return tuple(
            Link(before=before, after=after, before_from_after=transform, covariance=covariance)
            for before, after, transform, covariance in zip(befores, nodes, between, covariances, strict=True)
        )

    def carried(self, places: Mapping[int, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return the poses (N, 4, 4) of all nodes from the places of some, with node 0, and odometry from there."""
        nodes = range(len(self._before))
        owners = list(nodes)
        for node in nodes:
            if node not in places:
                owners[node] = owners[self._before[node]]
        return portable.matmul(np.array([places[owner] for owner in owners]), self._between(owners, nodes))

    def _up_to(self, node: int, kept: set[int]) -> int:
        node = self._before[node]
        while node not in kept:
            node = self._before[node]
        return node

    def _meeting(self, a: int, b: int) -> int:
        # The last common node on the paths to node 0; edges lead from earlier nodes to later ones.
        while a != b:
            a, b = (self._before[a], b) if a > b else (a, self._before[b])
        return a

    def _between(self, firsts: Sequence[int], seconds: Sequence[int]) -> NDArray[np.float64]:
        # (K, 4, 4) first_from_second of pairs of nodes.
        return portable.matmul(self._node_from_world[list(firsts)], self.world_from_node[list(seconds)])

    def _known(self, nodes: Sequence[int], errors: NDArray[np.float64]) -> NDArray[np.float64]:
        # (K, 6, 6) covariances of paths, each in the frame of its last node, with known verticals; `errors` (K, 6, 6)
        # are small motions in the frame of the world.
        if not nodes:
            return np.empty((0, 6, 6))
        node_from_world = self._node_from_world[nodes]
        carry = _adjoints(node_from_world[:, :3, :3], node_from_world[:, :3, 3])
        covariances = portable.matmul(portable.matmul(carry, errors), np.swapaxes(carry, 1, 2))
        return _with_verticals(covariances, self._upright[nodes], self._gravity_sigma_rad)


def _adjoints(rotations: NDArray[np.float64], places: NDArray[np.float64]) -> NDArray[np.float64]:
    # `adjoint` (N, 6, 6) of transforms with these rotations (N, 3, 3) and places (N, 3).
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
    # Measured verticals at both ends, `ups` (K, 3), fix turns about level axes: two scalar updates as in a Kalman
    # filter.
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
