"""One simulated alignment and how good it was: the errors where the maps overlap, and the floor that noise allows."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.alignment.registration import information
from hickory_stream.geometry.rigid import apply, invert
from tools.evaluation.alignment_error import AlignmentError, error_of
from tools.evaluation.simulated_maps.simulate import SimulatedPair, SimulationConfig, simulate_pair

# The median over the RMS of the length of a normally distributed vector, in three dimensions and in one.
_MEDIAN_3, _MEDIAN_1 = 0.888, 0.6745
_SIGMA_M = 0.05 * np.sqrt(2.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial:
    """The result for one pair of maps: the error, or None if the alignment was refused for the reason `refusal`."""

    error: AlignmentError | None
    refusal: str | None

    @property
    def is_success(self) -> bool:
        return self.error is not None and self.error.is_success

    @property
    def is_wrong(self) -> bool:
        return self.error is not None and not self.error.is_success


def run_trial(config: SimulationConfig, seed: int) -> Trial:
    """Return the result of `align` for the simulated pair of a seed."""
    pair = simulate_pair(config, seed)
    answer = align(pair.map_a, pair.map_b)
    if not isinstance(answer, Alignment):
        return Trial(error=None, refusal=answer.refusal.value)
    return Trial(error=error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)), refusal=None)


def normalised_square(answer: Alignment, true_a_from_b: NDArray[np.float64]) -> float:
    """Return the squared error of an alignment in units of its covariance: 6 on average if that is right."""
    away = answer.a_from_b @ invert(true_a_from_b)
    turn = Rotation.from_matrix(away[:3, :3]).as_rotvec()
    error = np.concatenate([turn, apply(away, answer.center_a) - answer.center_a])
    return float(error @ np.linalg.solve(answer.covariance, error))


def overlap_b(pair: SimulatedPair) -> NDArray[np.float64]:
    """Return the true centroid (3,) of the common objects in map b, or of all objects of b if none is common."""
    if not len(pair.common):
        return np.asarray(pair.map_b.centroids.mean(axis=0))
    return np.asarray(apply(invert(pair.a_from_b), pair.common_centroids_a).mean(axis=0))


def noise_floor(config: SimulationConfig, seed: int) -> tuple[float, float]:
    """Return the median errors (metres at the overlap, degrees) of an efficient estimate that knows all true pairs."""
    # It is the Cramer-Rao bound, with known gravity if the maps are level.
    pair = simulate_pair(config, seed)
    points = pair.common_centroids_a
    total = information(points, np.full(len(points), _SIGMA_M), points.mean(axis=0))
    free = [2, 3, 4, 5] if config.tilt_deg == 0 else [0, 1, 2, 3, 4, 5]
    covariance = np.linalg.inv(total[np.ix_(free, free)])
    shift = np.sqrt(np.trace(covariance[-3:, -3:]))
    turn = np.sqrt(np.trace(covariance[:-3, :-3]))
    return float(_MEDIAN_3 * shift), float(np.degrees((_MEDIAN_1 if config.tilt_deg == 0 else _MEDIAN_3) * turn))
