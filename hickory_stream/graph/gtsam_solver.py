"""The pose graph in GTSAM: factors, start values, covariances, and graduated non-convexity; the one importer of GTSAM.

Nodes are eliminated one by one. GTSAM's multifrontal elimination joins nodes, and calls them indeterminate where the
certainty of their axes differs by more than 2^12: so does a jump beside a surely measured edge some metres long. Its
wheel runs on one thread: the same factors give the same bits, but for the C library's sine and cosine, which
`settled` rounds. Graduated non-convexity with truncated least squares (Yang et al., RA-L 2020): a factor counts up to a
limit of its squared residual; weights begin with those of a smooth cost and sharpen until each is 0 or 1.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.graph.chain import Link
from hickory_stream.graph.factors import LoopEdge, OdometryEdge

# Greater steps accepted wrong loops in simulation.
_STEP = 1.4
_SHARPEST = 1e6


def smoothest(chi2: NDArray[np.float64], limit: float) -> float:
    """Return the first sharpness for squared residuals (K,): each of them counts a little."""
    over = 2.0 * float(chi2.max(initial=0.0)) - limit
    return limit / max(over, limit / _SHARPEST)


def sharper(sharpness: float) -> float:
    """Return the sharpness of the next round."""
    return _STEP * sharpness


def weights_of(chi2: NDArray[np.float64], limit: float, sharpness: float) -> NDArray[np.float64]:
    """Return the weights (K,), 0..1, of squared residuals (K,)."""
    share = sharpness / (sharpness + 1.0)
    between = np.sqrt(sharpness * (sharpness + 1.0) * limit / np.maximum(chi2, 1e-12)) - sharpness
    return np.where(chi2 <= share * limit, 1.0, np.where(chi2 >= limit / share, 0.0, between))


# Node 0 is held this well, in radians and metres: far better than any edge, far from the end of double precision.
_HELD = 1e-5
# At each step of graduated non-convexity its limit is sharper by 1.4: far more than are needed.
_MOST_ROUNDS = 200
_DIGITS_M, _DIGITS_ROTATION = 6, 7


class Factors:
    """A factor graph that grows."""

    def __init__(self) -> None:
        import gtsam

        self._gtsam = gtsam
        self.graph, self.values = gtsam.NonlinearFactorGraph(), gtsam.Values()

    def add_nodes(self, nodes: Sequence[int], start: NDArray[np.float64]) -> None:
        """Add nodes by their numbers in `start` (N, 4, 4), the first of them held there."""
        gtsam = self._gtsam
        for node in nodes:
            self.values.insert(node, gtsam.Pose3(start[node]))
        held = gtsam.noiseModel.Isotropic.Sigma(6, _HELD)
        self._add(gtsam.PriorFactorPose3(nodes[0], gtsam.Pose3(start[nodes[0]]), held))

    def add_verticals(self, nodes: Sequence[int], upright: NDArray[np.float64], sigma_rad: float) -> None:
        """Add the verticals of nodes, as in `upright` (N, 4, 4), z up."""
        gtsam = self._gtsam
        up, level = gtsam.Unit3(np.array([0.0, 0.0, 1.0])), gtsam.noiseModel.Isotropic.Sigma(2, sigma_rad)
        for node in nodes:
            self._add(gtsam.AttitudeFactorPose3(node, up, level, gtsam.Unit3(upright[node][2, :3])))

    def add_odometry(self, edge: OdometryEdge | Link) -> None:
        """Add an edge that is never cut."""
        self._add(self._between(edge.before, edge.after, edge.before_from_after, edge.covariance))

    def add_loop(self, loop: LoopEdge) -> int:
        """Add a loop; return its place."""
        return self._add(self._between(loop.earlier, loop.later, loop.earlier_from_later, loop.covariance))

    def optimized(self) -> Any:
        """Return the values of least squares over all factors; raises RuntimeError."""
        parameters = self._gtsam.LevenbergMarquardtParams()
        parameters.setOrderingType("COLAMD")
        parameters.setLinearSolverType("SEQUENTIAL_CHOLESKY")
        return self._gtsam.LevenbergMarquardtOptimizer(self.graph, self.values, parameters).optimize()

    def judged(self, doubted: Sequence[int], limit_chi2: float) -> tuple[NDArray[np.float64], Any]:
        """Return the weights (K,), 0..1, of the factors at these places by graduated non-convexity, and values."""
        # GTSAM's `GncLMOptimizer` restarts in each round; from the last round one Gauss-Newton step is enough.
        factors: list[Any] = [self.graph.at(place) for place in doubted]
        roots = [factor.noiseModel().R() for factor in factors]
        ordering = self._gtsam.Ordering.ColamdNonlinearFactorGraph(self.graph)
        weighted, values = self._gtsam.NonlinearFactorGraph(self.graph), self.values
        weights = np.ones(len(factors))
        sharpness = 0.0
        for _ in range(_MOST_ROUNDS):
            chi2 = np.array([2.0 * factor.error(values) for factor in factors])
            sharpness = sharper(sharpness) if sharpness else smoothest(chi2, limit_chi2)
            weights = weights_of(chi2, limit_chi2, sharpness)
            if np.isin(weights, (0.0, 1.0)).all():
                break
            for place, factor, root, weight in zip(doubted, factors, roots, np.sqrt(weights), strict=True):
                model = self._gtsam.noiseModel.Gaussian.SqrtInformation(weight * root)
                weighted.replace(place, factor.cloneWithNewNoiseModel(model))
            values = values.retract(weighted.linearize(values).eliminateSequential(ordering).optimize())
        return weights, values

    def surprises(self, asked: Sequence[int], left_out: Collection[int], values: Any) -> NDArray[np.float64]:
        """Return the squared Mahalanobis distances (K,) of the factors `asked` from the prediction of others.

        The others are all factors without those at the places `left_out`, which include `asked`. Each distance is the
        rise of their least squared residual with the factor, to first order at `values`; raises RuntimeError.
        """
        ordering = self._gtsam.Ordering.ColamdNonlinearFactorGraph(self.graph)
        linear = self.graph.linearize(values)
        others = self._gtsam.GaussianFactorGraph()
        for place in range(linear.size()):
            if place not in left_out:
                others.push_back(linear.at(place))
        without = others.error(others.eliminateSequential(ordering).optimize())
        rises = []
        for place in asked:
            joined = others.clone()
            joined.push_back(linear.at(place))
            rises.append(2.0 * (joined.error(joined.eliminateSequential(ordering).optimize()) - without))
        return np.array(rises)

    def chi2(self, place: int, values: Any) -> float:
        """Return the squared residual of a factor, by its covariance."""
        return 2.0 * float(self.graph.at(place).error(values))

    def total_chi2(self, values: Any) -> float:
        """Return the squared residuals of all factors."""
        return 2.0 * float(self.graph.error(values))

    def marginals(self, poses: NDArray[np.float64]) -> "Marginals":
        """Return the marginals at poses (N, 4, 4) of nodes 0 to N - 1; raises RuntimeError if one is left open."""
        values = self._gtsam.Values()
        for node, pose in enumerate(poses):
            values.insert(node, self._gtsam.Pose3(pose))
        ordering = self._gtsam.Ordering.ColamdNonlinearFactorGraph(self.graph)
        root = self.graph.linearize(values).eliminateSequential(ordering)
        return Marginals(root, values.zeroVectors(), self._gtsam.VectorValues)

    def _between(self, a: int, b: int, a_from_b: NDArray[np.float64], covariance: NDArray[np.float64]) -> Any:
        noise = self._gtsam.noiseModel.Gaussian.Covariance(covariance)
        return self._gtsam.BetweenFactorPose3(a, b, self._gtsam.Pose3(a_from_b), noise)

    def _add(self, factor: Any) -> int:
        self.graph.add(factor)
        return int(self.graph.size()) - 1


class Marginals:
    """Covariances of small motions of nodes, from the root R of the information R'R."""

    def __init__(self, root: Any, zero: Any, vectors: Any) -> None:
        self._root, self._zero, self._vectors = root, zero, vectors

    def covariance(self, motion: Mapping[int, NDArray[np.float64]]) -> NDArray[np.float64]:
        """Return (6, 6) of a motion J, a sum of its nodes' small motions by (6, 6)."""
        # It is Y'Y, where R'Y = J'. The difference of two nodes beyond a jump keeps its digits, which the difference of
        # their own covariances would lose.
        parts = np.empty((6, self._zero.vector().size))
        for axis in range(6):
            right, own = self._vectors(self._zero), self._vectors()
            for node, matrix in motion.items():
                own.insert(node, matrix[axis])
            right.update(own)
            parts[axis] = self._root.backSubstituteTranspose(right).vector()
        return portable.matmul(parts, parts.T)


def poses_of(values: Any, nodes: Iterable[int]) -> NDArray[np.float64]:
    """Return the poses (N, 4, 4) of nodes, not rounded."""
    return np.array([values.atPose3(node).matrix() for node in nodes])


def settled(values: Any, nodes: Iterable[int]) -> NDArray[np.float64]:
    """Return the poses (N, 4, 4) of nodes, rounded to a micrometre, and rotations to about a ten-millionth."""
    poses = poses_of(values, nodes)
    poses[:, :3, :3] = portable.nearest_orthogonal(np.round(poses[:, :3, :3], _DIGITS_ROTATION))
    poses[:, :3, 3] = np.round(poses[:, :3, 3], _DIGITS_M)
    return poses
