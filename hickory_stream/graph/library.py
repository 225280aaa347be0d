"""The graph as GTSAM has it: factors, start values, marginals. The one module that imports the library.

Its wheel has no TBB and runs on one thread: the same factors give the same solution to the last bit. The C library's
sine and cosine may differ in the last bit between kinds of processor; `settled` rounds it away.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry import portable

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from hickory_stream.graph.chain import Link
    from hickory_stream.graph.factors import LoopEdge, OdometryEdge

# Node 0 is held this well, in radians and metres: far better than any edge, far from the end of double precision.
_HELD = 1e-5
_GNC_STEP = 1.4
# Weights need no more exact places than two steps give; three take a third longer.
_GNC_INNER_STEPS = 2
_DIGITS_M, _DIGITS_ROTATION = 6, 7


class Factors:
    """A factor graph that grows; `sure` are the places of factors that are not to be doubted."""

    def __init__(self) -> None:
        import gtsam

        self._gtsam = gtsam
        self.graph = gtsam.NonlinearFactorGraph()
        self.values = gtsam.Values()
        self.sure: list[int] = []

    def add_nodes(self, nodes: Sequence[int], start: NDArray[np.float64]) -> None:
        """Add nodes by their numbers in `start` (N, 4, 4), the first of them held there."""
        gtsam = self._gtsam
        for node in nodes:
            self.values.insert(node, gtsam.Pose3(start[node]))
        held = gtsam.noiseModel.Isotropic.Sigma(6, _HELD)
        self._add_sure(gtsam.PriorFactorPose3(nodes[0], gtsam.Pose3(start[nodes[0]]), held))

    def add_verticals(self, nodes: Sequence[int], upright: NDArray[np.float64], sigma_rad: float) -> None:
        """Add that the vertical of nodes is the one that they have in `upright` (N, 4, 4), z up."""
        gtsam = self._gtsam
        up, level = gtsam.Unit3(np.array([0.0, 0.0, 1.0])), gtsam.noiseModel.Isotropic.Sigma(2, sigma_rad)
        for node in nodes:
            self._add_sure(gtsam.AttitudeFactorPose3(node, up, level, gtsam.Unit3(upright[node][2, :3])))

    def add_odometry(self, edge: OdometryEdge | Link) -> None:
        """Add an edge that is not to be cut: its covariance says how far it may stretch."""
        self._add_sure(self._between(edge.before, edge.after, edge.before_from_after, edge.covariance))

    def add_loop(self, loop: LoopEdge) -> int:
        """Add a loop; return its place."""
        return self._add(self._between(loop.earlier, loop.later, loop.earlier_from_later, loop.covariance))

    def optimized(self) -> Any:
        """Return the values of least squares, all factors taken as they are; raises RuntimeError."""
        return self._gtsam.LevenbergMarquardtOptimizer(self.graph, self.values, _parameters()).optimize()

    def weights(self, inlier_chi2: float) -> NDArray[np.float64]:
        """Return the weights (F,) that graduated non-convexity gives to factors, 0..1; raises RuntimeError."""
        gtsam = self._gtsam
        parameters = gtsam.GncLMParams(_parameters(most_steps=_GNC_INNER_STEPS))
        parameters.setLossType(gtsam.GncLossType.TLS)
        # Its faster schedule, and greater steps, accepted wrong loops in simulation.
        parameters.setScheduler(gtsam.GncScheduler.Linear)
        parameters.setLambdaStep(_GNC_STEP)
        # Until weights are 0 or 1: with tolerances it ends at once where the first weights are all next to 0.
        parameters.setWeightsTol(0.0)
        parameters.setRelativeCostTol(0.0)
        parameters.setKnownInliers(self.sure)
        optimizer = gtsam.GncLMOptimizer(self.graph, self.values, parameters)
        optimizer.setInlierCostThresholds(0.5 * inlier_chi2)
        optimizer.optimize()
        return np.asarray(optimizer.getWeights(), dtype=np.float64).reshape(-1)

    def chi2(self, place: int, values: Any) -> float:
        """Return the squared residual of a factor, by its covariance."""
        return 2.0 * float(self.graph.at(place).error(values))

    def total_chi2(self, values: Any) -> float:
        """Return the squared residuals of all factors."""
        return 2.0 * float(self.graph.error(values))

    def marginals(self, values: Any) -> Any:
        """Return GTSAM's marginals at a solution; raises RuntimeError."""
        return self._gtsam.Marginals(self.graph, values)

    def _between(self, a: int, b: int, a_from_b: NDArray[np.float64], covariance: NDArray[np.float64]) -> Any:
        noise = self._gtsam.noiseModel.Gaussian.Covariance(covariance)
        return self._gtsam.BetweenFactorPose3(a, b, self._gtsam.Pose3(a_from_b), noise)

    def _add(self, factor: Any) -> int:
        self.graph.add(factor)
        return int(self.graph.size()) - 1

    def _add_sure(self, factor: Any) -> None:
        self.sure.append(self._add(factor))


def _parameters(most_steps: int = 100) -> Any:
    import gtsam

    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(most_steps)
    parameters.setOrderingType("COLAMD")
    parameters.setLinearSolverType("MULTIFRONTAL_CHOLESKY")
    return parameters


def settled(values: Any, nodes: Iterable[int]) -> NDArray[np.float64]:
    """Return the poses (N, 4, 4) of nodes, rounded to a micrometre, and rotations to about a ten-millionth."""
    poses = np.array([values.atPose3(node).matrix() for node in nodes])
    poses[:, :3, :3] = portable.nearest_orthogonal(np.round(poses[:, :3, :3], _DIGITS_ROTATION))
    poses[:, :3, 3] = np.round(poses[:, :3, 3], _DIGITS_M)
    return poses
