"""How much likelier objects of unrelated homes coincide where furniture stands in groups.

One group laid on another coincides as a whole: hardly more than one observation. Given one coincident pair of like
objects, another pair d metres from it coincides with the density `_PER_M3` instead of 1 / V (a pair correlation
function: Ripley 1976; Baddeley, Rubak and Turner 2015, chapter 7). The probability of a set is the product over its
pairs, each given the nearest one before it (Chow and Liu 1968).

Objects crowd on tables and shelves, and those of one table lie on those of another, alike or not. A pair therefore
coincides at least as densely as objects stand there in both maps: a kernel estimate from the other objects of a map,
with the bandwidths of the greatest cross-validated likelihood (Duin 1976).

`tools/benchmarks/alignment/furniture_groups.py` of commit e61aa87c measured the table on 100 pairs of different
apartments, seeds 0 to 31, among the 2 % of all pairs that look most alike; less alike pairs have a thinner surplus.
Whether a map has groups follows from two counts, of objects near one another and a room's width apart: Poisson numbers,
even odds before.
"""

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
# The bandwidths that are tried: level, and up.
_LEVEL_M, _UP_M = (0.25, 0.5, 1.0, 2.0), (0.1, 0.2, 0.4, 0.8)


def log_prices(
    points: NDArray[np.float64],
    log_ranks: NDArray[np.float64],
    log_densities: NDArray[np.float64],
    grouped: float,
    volume_m3: float,
) -> NDArray[np.float64]:
    """Return (K,) ln of how many times likelier the first 1, 2, ... K pairs coincide than in uniform places.

    Args:
        points: (K, 3) where the pairs coincide.
        log_ranks: (K,) how alike the two objects of each are.
        log_densities: (K,) how densely objects stand there (`log_densities_of`).
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
    crowded = np.log1p(grouped * np.maximum(volume_m3 * np.exp(log_densities) - 1.0, 0.0))
    nearest[1:] = np.maximum(nearest, crowded)[1:]
    return np.asarray(np.cumsum(nearest))


def log_densities_of(centroids: NDArray[np.float64], volume_m3: float) -> NDArray[np.float64]:
    """Return (N,) ln of how many of the other (N, 3) objects, as a share, are in a cubic metre at each of them.

    One object more is anywhere in `volume_m3`.
    """
    offsets = centroids[:, None] - centroids[None]
    level_m2, up_m2 = np.square(offsets[..., :2]).sum(axis=2), np.square(offsets[..., 2])
    np.fill_diagonal(level_m2, np.inf)
    densities = []
    for level_m in _LEVEL_M:
        near = np.exp(level_m2 / (-2 * level_m**2)) / ((2 * np.pi) ** 1.5 * level_m**2)
        for up_m in _UP_M:
            kernels = near * np.exp(up_m2 / (-2 * up_m**2)) / up_m
            densities.append(np.log((kernels.sum(axis=1) + 1 / volume_m3) / len(centroids)))
    return max(densities, key=lambda found: float(found.sum()))


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
