"""How much likelier objects of unrelated homes coincide where furniture stands in groups.

One group laid on another coincides as a whole: hardly more than one observation. Given one coincident pair of like
objects, another pair d metres from it coincides with the density `_PER_M3` instead of 1 / V (a pair correlation
function: Ripley 1976; Baddeley, Rubak and Turner 2015, chapter 7). The probability of a set is the product over its
pairs, each given the nearest one before it (Chow and Liu 1968).

`tools/benchmarks/alignment/furniture_groups.py` of commit e61aa87c measured the table on 100 pairs of different
apartments, seeds 0 to 31, among the 2 % of all pairs that look most alike; less alike pairs have a thinner surplus.
Whether a map has groups follows from two counts, of objects near one another and a room's width apart: Poisson numbers,
even odds before.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

# Level distance in metres, and the density with which another like pair coincides there.
_DISTANCES_M = (0.2, 0.5, 0.85, 1.25, 1.75, 2.5, 3.5, 5.0, 7.5)
_PER_M3 = (1.8, 0.84, 0.38, 0.095, 0.027, 0.025, 0.017, 0.011, 0.009)
_ALIKE = 0.02
# So near to one another there are, in units of how many there are further off, objects of grouped and of other places.
_NEAR_M, _FAR_M = 0.7, (1.5, 3.0)
_GROUPED, _SCATTERED = 2.9, 1.2


def log_prices(
    points: NDArray[np.float64], log_ranks: NDArray[np.float64], grouped: float, volume_m3: float
) -> NDArray[np.float64]:
    """Return (K,) ln of how many times likelier the first 1, 2, ... K pairs coincide than in uniform places.

    Args:
        points: (K, 3) where the pairs coincide.
        log_ranks: (K,) how alike the two objects of each are.
        grouped: the probability that the two places are furnished in groups.
        volume_m3: V, that the objects of a place occupy.
    """
    count = len(points)
    if count < 2:
        return np.zeros(count)
    level = np.hypot(*(points[:, None, :2] - points[None, :, :2]).transpose(2, 0, 1))
    times = volume_m3 * np.exp(np.interp(level, _DISTANCES_M, np.log(_PER_M3)))
    surplus = np.maximum(times - 1.0, 0.0)
    thinned = np.minimum(1.0, _ALIKE * np.exp(-np.maximum.outer(log_ranks, log_ranks)))
    likelier = np.log1p(grouped * thinned * surplus)
    nearest = np.where(np.tri(count, k=-1, dtype=bool), likelier, 0.0).max(axis=1)
    return np.asarray(np.cumsum(nearest))


def grouped_probability(centroids: tuple[NDArray[np.float64], NDArray[np.float64]]) -> float:
    """Return the probability that things stand in groups in the places of two maps, (N, 3) and (M, 3) objects."""
    counts = np.array([crowding(own) for own in centroids]).sum(axis=0)
    odds = counts[0] * np.log(_GROUPED / _SCATTERED) - counts[1] * (_GROUPED - _SCATTERED)
    return float(1.0 / (1.0 + np.exp(-np.clip(odds, -50.0, 50.0))))


def crowding(centroids: NDArray[np.float64]) -> tuple[float, float]:
    """Return how many pairs of (N, 3) objects are near each other, and how many would be as dense as further off."""
    tree = cKDTree(centroids[:, :2])
    radii_m = np.array([_NEAR_M, *_FAR_M])
    near, inner, outer = (tree.count_neighbors(tree, radii_m) - len(centroids)) / 2
    return float(near), float((outer - inner) * _NEAR_M**2 / (_FAR_M[1] ** 2 - _FAR_M[0] ** 2))
