"""The factors of a pose graph: odometry and loops between submaps, with their covariances.

Covariances are in the tangent space of GTSAM's `Pose3`: a small turn about x, y, z (rad), then a small shift along
x, y, z (m), both in the frame of the second node of an edge: true = measured * Exp(error).
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import invert, is_rigid
from hickory_stream.graph.config import GraphConfig

LoopMethod = Literal["surface", "appearance", "objects"]
# No edge is known better than this.
FLOOR_M = 0.01
_FLOOR_RAD = 0.002
# Noise of rotation, for the root of the path in metres.
_TURN_NOISE = 0.0045
# Error in rotation, for each radian turned.
_TURN_SHARE = 0.005
# Where every keyframe was registered, its covariance counts this many times: the surfaces compared err alike.
_REGISTERED_FACTOR = 4.0
# Error as a share of the path, and of the turn, along which scans did not constrain the motion.
DEGENERATE_SHARE = 0.3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class OdometryEdge:
    """Odometry between two nodes: `before_from_after` (4, 4) with its `covariance` (6, 6)."""

    before: int
    after: int
    before_from_after: NDArray[np.float64]
    covariance: NDArray[np.float64]
    #: the odometry jumped in between, or the path is unknown
    is_jump: bool = False

    def __post_init__(self) -> None:
        _check_pair(self.before, self.after)
        _freeze_edge(self, "before_from_after")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LoopEdge:
    """A place that was seen again: `earlier_from_later` (4, 4) between two nodes, with its `covariance` (6, 6)."""

    #: permanent name of the loop
    id: int
    earlier: int
    later: int
    earlier_from_later: NDArray[np.float64]
    covariance: NDArray[np.float64]
    method: LoopMethod
    #: of its method, higher is better
    score: float
    #: when it was found
    stamp_ns: int

    def __post_init__(self) -> None:
        _check_pair(self.earlier, self.later)
        _freeze_edge(self, "earlier_from_later")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PoseGraph:
    """The factors of N nodes; each after the first has one odometry edge to an earlier one; ids of loops differ."""

    #: (N, 4, 4) poses of odometry; node 0 stays at its pose
    world_from_node: NDArray[np.float64]
    odometry: tuple[OdometryEdge, ...]
    loops: tuple[LoopEdge, ...]
    #: certainty of the vertical of each pose (an accelerometer; wide without one)
    gravity_sigma_rad: float

    def __post_init__(self) -> None:
        freeze(self, "world_from_node", np.float64, (None, 4, 4))
        num_nodes = self.num_nodes
        if not np.isfinite(self.world_from_node).all():
            raise ValueError("a pose of the graph is not finite")
        if sorted(edge.after for edge in self.odometry) != list(range(1, num_nodes)):
            raise ValueError(f"each of nodes 1 to {num_nodes - 1} must hang on an earlier one by one odometry edge")
        if any(loop.later >= num_nodes for loop in self.loops):
            raise ValueError(f"a loop ends at a node that is not there; there are {num_nodes}")
        if len({loop.id for loop in self.loops}) < len(self.loops):
            raise ValueError("two loops have one id")
        if not self.gravity_sigma_rad > 0:
            raise ValueError(f"gravity_sigma_rad is {self.gravity_sigma_rad}; expected more than 0")

    @property
    def num_nodes(self) -> int:
        """The number of nodes."""
        return len(self.world_from_node)


def odometry_covariance(
    way_m: float, turn_rad: float, config: GraphConfig, *,
    jump_m: float = 0.0, jump_rad: float = 0.0, blind: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:  # fmt: skip
    """Return the (6, 6) covariance of an edge of odometry by the length and the turns of its path.

    `jump_m`, `jump_rad`: what a jump of the odometry leaves open. `blind` (6, 6): lengths of the path, along the axes
    of the second node, that scans did not constrain: turns (rad) and shifts (m); None: of no length.
    """
    turns = (_FLOOR_RAD, config.turn_drift_per_m * way_m, _TURN_SHARE * turn_rad, jump_rad)
    variance_m = sum(value * value for value in (FLOOR_M, config.drift_share * way_m, jump_m))
    variance_rad = sum(value * value for value in turns)
    variance_m += config.path_noise * config.path_noise * way_m
    variance_rad += _TURN_NOISE * _TURN_NOISE * way_m
    covariance = np.diag([variance_rad] * 3 + [variance_m] * 3)
    if blind is None:
        return covariance
    error = DEGENERATE_SHARE * blind
    return symmetric(covariance + portable.matmul(error, error.T))


def registered_covariance(covariance: NDArray[np.float64], after: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (6, 6) covariance of an edge from its least certain keyframe's; `after` (4, 4): second node."""
    floor = np.diag([_FLOOR_RAD * _FLOOR_RAD] * 3 + [FLOOR_M * FLOOR_M] * 3)
    return floor + _REGISTERED_FACTOR * along_axes_of(after, covariance)


def along_axes_of(node: NDArray[np.float64], matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a matrix (6, 6) of turns and shifts, given in the map's axes, in the axes of a node's pose (4, 4)."""
    carry = np.zeros((6, 6))
    carry[:3, :3] = carry[3:, 3:] = node[:3, :3].T
    return symmetric(portable.matmul(portable.matmul(carry, matrix), carry.T))


def tangent_covariance(
    a_from_b: NDArray[np.float64], covariance: NDArray[np.float64], center_a: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the (6, 6) covariance of an edge from an alignment's: a turn about `center_a` (3,) in a, then a shift."""
    at_origin = np.eye(6)
    at_origin[3:, :3] = _cross_matrix(center_a)
    to_tangent = portable.matmul(adjoint(invert(a_from_b)), at_origin)
    return symmetric(portable.matmul(portable.matmul(to_tangent, covariance), to_tangent.T))


def adjoint(a_from_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (6, 6) matrix that takes a small motion (turn, shift) in frame b to the same motion in frame a."""
    rotation = a_from_b[:3, :3]
    matrix = np.zeros((6, 6))
    matrix[:3, :3] = matrix[3:, 3:] = rotation
    matrix[3:, :3] = portable.matmul(_cross_matrix(a_from_b[:3, 3]), rotation)
    return matrix


def symmetric(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a matrix (n, n) without the asymmetry of rounding."""
    return 0.5 * (matrix + matrix.T)


def _cross_matrix(vector: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _check_pair(first: int, second: int) -> None:
    if not 0 <= first < second:
        raise ValueError(f"an edge goes from an earlier node to a later one, found {first} to {second}")


def _freeze_edge(edge: OdometryEdge | LoopEdge, transform: str) -> None:
    freeze(edge, transform, np.float64, (4, 4))
    freeze(edge, "covariance", np.float64, (6, 6))
    if not is_rigid(getattr(edge, transform)):
        raise ValueError(f"{transform} is not rigid")
    covariance = edge.covariance
    # A variance of 1e12 m2 is a thousand kilometres; products of greater ones overflow.
    is_plain = np.isfinite(covariance).all() and np.abs(covariance).max() <= 1e12
    if not is_plain or float(portable.eigh(symmetric(covariance))[0][0]) <= 0:
        raise ValueError("the covariance of an edge must be finite, at most 1e12, and positive definite")
