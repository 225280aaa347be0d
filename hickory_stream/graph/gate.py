"""The gate before the solver: it rejects loops that odometry, with its uncertainty, cannot explain."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import solve_in_place
from hickory_stream.geometry.rigid import invert, rotation_vector
from hickory_stream.graph.chain import Prediction
from hickory_stream.graph.factors import LoopEdge


@dataclass(frozen=True, kw_only=True, slots=True)
class Surprise:
    """The distance of a loop from odometry's prediction: place, angle, and squared Mahalanobis distance (6 dof)."""

    distance_m: float
    angle_rad: float
    chi2: float


def surprise_of(loop: LoopEdge, prediction: Prediction) -> Surprise:
    """Return the distance of a loop from odometry's prediction, with the uncertainty of both."""
    error = difference(loop.earlier_from_later, prediction.earlier_from_later)
    return Surprise(
        distance_m=portable.norm(error[3:]),
        angle_rad=portable.norm(error[:3]),
        chi2=mahalanobis2(error, prediction.covariance + loop.covariance),
    )


def difference(a_from_b: NDArray[np.float64], other_a_from_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the small motion (6,) in frame b, turn then shift, that takes the first transform to the other."""
    motion = portable.matmul(invert(a_from_b), other_a_from_b)
    return np.concatenate([rotation_vector(motion[:3, :3]), motion[:3, 3]])


def mahalanobis2(error: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Return the squared Mahalanobis distance of an error (n,) by its covariance (n, n)."""
    solution = np.array(error, dtype=np.float64)
    solve_in_place(np.array(covariance, dtype=np.float64, order="C"), solution)
    return portable.dot(np.asarray(error), solution)
