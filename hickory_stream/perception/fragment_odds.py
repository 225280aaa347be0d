"""What the network of affinities says of fragments: of every two with pixels at its distances, and of each alone.

The odds of pixels are bytes, their sums over the pixels of two fragments are integers: those of groups of fragments
follow from those of their members, exactly and in any order. Joining by the mean affinity between two groups is the
average linkage of GASP (Bailoni et al. 2019), which they found the most robust; Wolf et al. 2018 is its rival.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.perception.pixel_network import DISTANCES_PX, ODDS_UNIT, ODDS_ZERO, OFFSETS

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.pixel_network import PixelOdds

_NEAR_DISTANCES = 2
"""So many of the distances, the least, are near: across a seam rather than from inside to inside."""
_NUM_NEAR = _NEAR_DISTANCES * (len(OFFSETS) // len(DISTANCES_PX))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FragmentOdds:
    """Sums over n fragments and K pairs a < b of them; row 0 of the fragments is nothing.

    Of a pair: `near` and `far`, the sums of the bytes' distances from even odds over `num_near` and `num_far` pairs of
    pixels. Of a fragment: `thing` and `num_pixels`. All int64.
    """

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    near: NDArray[np.int64]
    num_near: NDArray[np.int64]
    far: NDArray[np.int64]
    num_far: NDArray[np.int64]
    thing: NDArray[np.int64]
    num_pixels: NDArray[np.int64]

    def of_groups(self, numbers: NDArray[np.int64], count: int) -> FragmentOdds:
        """Return the sums of `count` groups; `numbers` (n,) names the group of each fragment."""
        a, b = numbers[self.a], numbers[self.b]
        key = np.minimum(a, b) * count + np.maximum(a, b)
        keys, place = np.unique(key[a != b], return_inverse=True)
        sums = (
            _summed(values[a != b], place, len(keys)) for values in (self.near, self.num_near, self.far, self.num_far)
        )
        near, num_near, far, num_far = sums
        return FragmentOdds(
            a=keys // count,
            b=keys % count,
            near=near,
            num_near=num_near,
            far=far,
            num_far=num_far,
            thing=_summed(self.thing, numbers, count),
            num_pixels=_summed(self.num_pixels, numbers, count),
        )

    def means_of(self, pairs: NDArray[np.int64], count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return (M,) the mean near and far log-odds of (M, 2) pairs of `count` fragments; NaN where there are none."""
        keys = self.a * count + self.b
        wanted = pairs.min(axis=1) * count + pairs.max(axis=1)
        place = np.minimum(np.searchsorted(keys, wanted), max(len(keys) - 1, 0))
        is_there = keys[place] == wanted if len(keys) else np.zeros(len(wanted), dtype=bool)
        means = []
        for sums, counts in ((self.near, self.num_near), (self.far, self.num_far)):
            mean = np.full(len(pairs), np.nan)
            if len(keys):
                has = is_there & (counts[place] > 0)
                mean[has] = sums[place][has] / (ODDS_UNIT * counts[place][has])
            means.append(mean)
        return means[0], means[1]

    def thing_means(self) -> NDArray[np.float64]:
        """Return (n,) the mean log-odds that a fragment is of a thing; 0 where it has no pixel of the network's."""
        return np.asarray(self.thing / (ODDS_UNIT * np.maximum(self.num_pixels, 1)))


def fragment_odds(labels: NDArray[np.int32], odds: PixelOdds) -> FragmentOdds:
    """Return the sums of the fragments `labels` (H, W), 0 = none, at the surface's size."""
    few = np.ascontiguousarray(labels[::2, ::2])
    count = int(labels.max(initial=0)) + 1
    pair_sums, sums = _sums(few, odds.odds, np.array(OFFSETS), _NUM_NEAR, count)
    keys = np.flatnonzero(pair_sums[:, 1] + pair_sums[:, 3])
    return FragmentOdds(
        a=keys // count,
        b=keys % count,
        near=pair_sums[keys, 0],
        num_near=pair_sums[keys, 1],
        far=pair_sums[keys, 2],
        num_far=pair_sums[keys, 3],
        thing=sums[:, 0],
        num_pixels=sums[:, 1],
    )


def averaged(odds: FragmentOdds, least: float, far_weight: float) -> NDArray[np.int64]:
    """Return (n,) the group of each fragment, by average linkage: the two with the greatest mean odds are joined first.

    Until there are none with a mean log-odds of `least`; pairs of pixels that are far apart weigh `far_weight`.
    Groups are numbered in the order of their first fragments.
    """
    count = len(odds.thing)
    sums, weights = np.zeros((count, count)), np.zeros((count, count))
    sums[odds.a, odds.b] = (odds.near + far_weight * odds.far) / ODDS_UNIT
    weights[odds.a, odds.b] = odds.num_near + far_weight * odds.num_far
    names = _linked(sums + sums.T, weights + weights.T, least)
    return np.unique(names, return_inverse=True)[1].astype(np.int64)


def _summed(values: NDArray[np.int64], place: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    # Sums of whole numbers far below 2^53 are exact in double precision.
    return np.bincount(place, weights=values.astype(np.float64), minlength=count).astype(np.int64)


@numba.njit(cache=True, nogil=True)
def _sums(labels, odds, offsets, num_near, count):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return for every two labels, the lesser first, sums and counts of near and of far odds; and those of things."""
    height, width = labels.shape
    pairs = np.zeros((count * count, 4), dtype=np.int64)
    own = np.zeros((count, 2), dtype=np.int64)
    last = len(offsets)
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if label == 0:
                continue
            own[label, 0] += np.int64(odds[last, y, x]) - ODDS_ZERO
            own[label, 1] += 1
            for i in range(last):
                yy, xx = y + offsets[i, 0], x + offsets[i, 1]
                if yy >= height or xx < 0 or xx >= width:
                    continue
                other = labels[yy, xx]
                if other == 0 or other == label:
                    continue
                at = min(label, other) * count + max(label, other)
                side = 0 if i < num_near else 2
                pairs[at, side] += np.int64(odds[i, y, x]) - ODDS_ZERO
                pairs[at, side + 1] += 1
    return pairs, own


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
