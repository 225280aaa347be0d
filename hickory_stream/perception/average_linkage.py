"""Merging of fragments by the network alone: average linkage, greatest mean odds first.

Joining by the mean affinity between two groups is the average linkage of GASP (Bailoni et al. 2019), which they found
the most robust; Wolf et al. 2018 is its rival.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.perception.fragment_odds import far_of, near_of
from hickory_stream.perception.pixel_network import ODDS_UNIT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.fragment_odds import FragmentOdds


def averaged(odds: FragmentOdds, least: float, far_weight: float) -> NDArray[np.int64]:
    """Return (n,) the group of each fragment, by average linkage: the two with the greatest mean odds are joined first.

    Until there are none with a mean log-odds of `least`; pairs of pixels that are far apart weigh `far_weight`.
    Groups are numbered in the order of their first fragments.
    """
    count = len(odds.thing)
    sums, weights = np.zeros((count, count)), np.zeros((count, count))
    counts = odds.levels.sum(axis=2)
    sums[odds.a, odds.b] = (near_of(odds.sums) + far_weight * far_of(odds.sums)) / ODDS_UNIT
    weights[odds.a, odds.b] = near_of(counts) + far_weight * far_of(counts)
    names = _linked(sums + sums.T, weights + weights.T, least)
    return np.unique(names, return_inverse=True)[1].astype(np.int64)


@numba.njit(cache=True, nogil=True)
def _linked(sums, weights, least):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the name of each group: its first member; of equal means the pair that comes first is joined first."""
    count = len(sums)
    names = np.arange(count)
    alive = np.ones(count, dtype=np.bool_)
    best = np.full(count, -np.inf)
    partner = np.zeros(count, dtype=np.int64)
    for i in range(count):
        _choose(sums, weights, alive, i, best, partner)
    while True:
        a = -1
        for i in range(count):
            if alive[i] and best[i] >= least and (a < 0 or best[i] > best[a]):
                a = i
        if a < 0:
            return names
        b = partner[a]
        a, b = min(a, b), max(a, b)
        alive[b] = False
        for i in range(count):
            if names[i] == b:
                names[i] = a
            if alive[i] and i != a:
                sums[a, i] += sums[b, i]
                weights[a, i] += weights[b, i]
                sums[i, a], weights[i, a] = sums[a, i], weights[a, i]
        sums[a, a], weights[a, a] = 0.0, 0.0
        for i in range(count):
            if alive[i] and (i == a or weights[i, a] > 0 or partner[i] == a or partner[i] == b):
                _choose(sums, weights, alive, i, best, partner)


@numba.njit(cache=True, nogil=True)
def _choose(sums, weights, alive, i, best, partner):  # type: ignore[no-untyped-def] # pragma: no cover
    """Find the living partner of i with the greatest mean."""
    best[i] = -np.inf
    for j in range(len(sums)):
        if j != i and alive[j] and weights[i, j] > 0:
            mean = sums[i, j] / weights[i, j]
            if mean > best[i]:
                best[i], partner[i] = mean, j
