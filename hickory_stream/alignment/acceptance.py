"""The a-contrario test: the expected number of false alarms of a set of pairs between two unrelated maps.

In unrelated maps of N and M objects, pairs of similar objects are consistent with one transform only by chance.
The expected number of sets of k pairs that are at least as similar and as consistent as those found is

    N! M! / ((N - k)! (M - k)! k!)   sets of k pairs without a common object
    x Q(k, -sum ln u)                of which so many rank as high (Fisher: u is the share of pairs that are as similar)
    x o B(R) / V^(k - 1)             of which so many are as consistent.

B(R) is the volume of the ball with the residual's norm R as radius in the 3 k - d dimensions that a transform of d
parameters leaves, o the volume of the transforms with their leverage on the k points, V the volume that objects occupy.
Four pairs are significant if few pairs of the two maps are similar, and insignificant if many are.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

_LEVEL_PARAMETERS, _TILTED_PARAMETERS = 4, 6
_NEAR_M, _NEAR_UP_M = 2.0, 0.3
_MIN_VOLUME_M3, _MIN_RESIDUAL_M = 1.0, 1e-3


@dataclass(frozen=True, kw_only=True, slots=True)
class Chance:
    """The background model of the test: the numbers of objects, and the volume that they occupy."""

    num_a: int
    num_b: int
    volume_m3: float
    max_tilt_rad: float
    #: how many times the expected false alarms of a level transform a tilted one has
    tilt_price: float = 1.0
    #: the probability that things stand in groups in both places (`grouping`)
    grouped: float = 0.0


def log_expected_sets(
    chance: Chance,
    log_ranks: NDArray[np.float64],
    square_sums_m2: NDArray[np.float64],
    scatters_m2: NDArray[np.float64],
    *,
    is_level: bool,
) -> NDArray[np.float64]:
    """Return (K,) ln of the expected number of sets as good as the first 1, 2, ... K pairs.

    Args:
        chance: the two maps.
        log_ranks: (K,) of each pair.
        square_sums_m2: (K,) sums of squared residuals of the first k pairs.
        scatters_m2: (K, 3, 3) sums of the outer products of the first k points about their mean.
        is_level: which transforms were fitted.
    """
    k = np.arange(1, len(log_ranks) + 1, dtype=np.float64)
    sets = _log_falling(chance.num_a, k) + _log_falling(chance.num_b, k) - gammaln(k + 1)
    looks = _log_upper_gamma(k, -np.cumsum(log_ranks))
    stands = _log_geometry(chance, k, square_sums_m2, scatters_m2, is_level)
    expected = sets + looks + stands + np.log(len(k) * (1.0 if is_level else chance.tilt_price))
    # Below this number of pairs any set fits.
    parameters = _LEVEL_PARAMETERS if is_level else _TILTED_PARAMETERS
    return np.where(3 * k >= parameters + 5, expected, np.inf)


def log_expected_coincidences(
    chance: Chance, counts: tuple[int, int], log_ranks: NDArray[np.float64], square_sums_m2: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return (K,) `log_expected_sets` of a known transform; `counts` of objects in each map are free to pair."""
    k = np.arange(1, len(log_ranks) + 1, dtype=np.float64)
    sets = _log_falling(counts[0], k) + _log_falling(counts[1], k) - gammaln(k + 1)
    looks = _log_upper_gamma(k, -np.cumsum(log_ranks))
    stands = np.minimum(_log_ball(3 * k, k, square_sums_m2) - k * np.log(chance.volume_m3), 0.0)
    return np.asarray(sets + looks + stands + np.log(len(k)))


def effective_volume_m3(centroids: NDArray[np.float64]) -> float:
    """Return 1 / the integral of the squared density of (N, 3) objects, smaller than the room if clustered."""
    count = len(centroids)
    if count < 2:
        return _MIN_VOLUME_M3
    first, second = np.triu_indices(count, 1)
    offsets = np.abs(centroids[first] - centroids[second])
    level = np.hypot(offsets[:, 0], offsets[:, 1])
    # One pair is added to the observed number: a bound for maps with few objects.
    area_m2 = np.pi * _NEAR_M**2 * len(first) / (np.count_nonzero(level < _NEAR_M) + 1)
    height_m = 2 * _NEAR_UP_M * len(first) / (np.count_nonzero(offsets[:, 2] < _NEAR_UP_M) + 1)
    return max(float(area_m2 * height_m), _MIN_VOLUME_M3)


def _log_falling(count: int, k: NDArray[np.float64]) -> NDArray[np.float64]:
    # ln of count! / (count - k)!.
    return np.asarray(gammaln(count + 1) - gammaln(np.maximum(count - k, 0) + 1))


def _log_upper_gamma(k: NDArray[np.float64], total: NDArray[np.float64]) -> NDArray[np.float64]:
    # ln Q(k, total): how likely k uniform numbers have a product of at most exp(-total).
    terms = np.arange(len(k))
    logs = terms * np.log(np.maximum(total, 1e-300))[:, None] - gammaln(terms + 1)
    logs = np.where(terms < k[:, None], logs, -np.inf)
    largest = logs.max(axis=1)
    return np.minimum(largest + np.log(np.exp(logs - largest[:, None]).sum(axis=1)) - total, 0.0)


def _log_geometry(
    chance: Chance,
    k: NDArray[np.float64],
    square_sums_m2: NDArray[np.float64],
    scatters_m2: NDArray[np.float64],
    is_level: bool,
) -> NDArray[np.float64]:
    level_spread = scatters_m2[:, 0, 0] + scatters_m2[:, 1, 1]
    if is_level:
        leverage = np.log(2 * np.pi) + 0.5 * np.log(np.maximum(level_spread, 1e-6))
        freedom = 3 * k - _LEVEL_PARAMETERS
    else:
        trace = np.trace(scatters_m2, axis1=1, axis2=2)
        inertia = trace[:, None, None] * np.eye(3) - scatters_m2
        tilts = np.log(2 * np.pi * (1 - np.cos(chance.max_tilt_rad)))
        determinant = np.maximum(np.linalg.det(inertia), 1e-9)
        leverage = np.log(2 * np.pi) + tilts + 0.5 * np.log(determinant)
        freedom = 3 * k - _TILTED_PARAMETERS
    freedom = np.maximum(freedom, 0)
    logs = leverage + 1.5 * np.log(k) + _log_ball(freedom, k, square_sums_m2) - (k - 1) * np.log(chance.volume_m3)
    return np.asarray(np.minimum(logs, 0.0))


def _log_ball(
    freedom: NDArray[np.float64], k: NDArray[np.float64], square_sums_m2: NDArray[np.float64]
) -> NDArray[np.float64]:
    # ln of the volume of the ball of `freedom` dimensions whose radius is the residual of k pairs.
    radius_m = np.sqrt(np.maximum(square_sums_m2, k * _MIN_RESIDUAL_M**2))
    return np.asarray(freedom / 2 * np.log(np.pi) - gammaln(freedom / 2 + 1) + freedom * np.log(radius_m))
