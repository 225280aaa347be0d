"""Log-odds of the affinity network, summed between every two fragments and within each fragment.

Sums of bytes are integers: the sums of a group of fragments follow from its members, exactly and in any order.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.perception.affinity.pixel_network import DISTANCES_PX, ODDS_UNIT, ODDS_ZERO, OFFSETS, PixelOdds
from hickory_stream.perception.regions.region_graph import merged_keys, summed

# Bin edges of pixel log-odds; the counts per bin (level) approximate their distribution.
LEVELS = (-2.0, 0.0, 2.0)
# The number of shortest distances that count as near: across a contact rather than between interiors.
NUM_NEAR = 2
_NUM_DISTANCES = len(DISTANCES_PX)
_NUM_LEVELS = len(LEVELS) + 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FragmentOdds:
    """Sums over n fragments (row 0 is background) and over K pairs a < b of fragments. All int64.

    Log-odds are bytes minus the byte of even odds, separately for each of D pixel distances.
    """

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    #: (K, D) over the pairs of pixels of a pair of fragments
    sums: NDArray[np.int64]
    #: (K, D, 4) their number below, between and above `LEVELS`
    levels: NDArray[np.int64]
    #: (n, D) sum over the pairs of pixels within a fragment
    inner: NDArray[np.int64]
    num_inner: NDArray[np.int64]
    #: (n,) sum of the log-odds of being an object
    thing: NDArray[np.int64]
    num_pixels: NDArray[np.int64]

    def of_groups(self, numbers: NDArray[np.int64], count: int) -> "FragmentOdds":
        """Return the sums of `count` groups; `numbers` (n,) names the group of each fragment."""
        a, b, places = merged_keys(self.a, self.b, numbers, count)
        # Pairs of two members of a group are within the group.
        within, counts = places < 0, self.levels.sum(axis=2)
        groups = numbers[self.a[within]]
        return FragmentOdds(
            a=a,
            b=b,
            sums=summed(self.sums, places, len(a)),
            levels=summed(self.levels, places, len(a)),
            inner=summed(self.inner, numbers, count) + summed(self.sums[within], groups, count),
            num_inner=summed(self.num_inner, numbers, count) + summed(counts[within], groups, count),
            thing=summed(self.thing, numbers, count),
            num_pixels=summed(self.num_pixels, numbers, count),
        )

    def of_pairs(self, pairs: NDArray[np.int64], count: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the sums (M, D) and levels (M, D, 4) of (M, 2) pairs of `count` fragments; 0 for unknown pairs."""
        wanted = pairs.min(axis=1) * count + pairs.max(axis=1)
        sums = np.zeros((len(pairs), _NUM_DISTANCES), dtype=np.int64)
        levels = np.zeros((len(pairs), _NUM_DISTANCES, _NUM_LEVELS), dtype=np.int64)
        keys = self.a * count + self.b
        if len(keys):
            place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            is_there = keys[place] == wanted
            sums[is_there], levels[is_there] = self.sums[place[is_there]], self.levels[place[is_there]]
        return sums, levels


def mean_log_odds(sums: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return mean log-odds from sums of bytes relative to even odds; NaN where the count is 0."""
    return np.where(counts > 0, sums / (ODDS_UNIT * np.maximum(counts, 1)), np.nan)


def fragment_odds(labels: NDArray[np.int32], odds: PixelOdds) -> FragmentOdds:
    """Return the sums of the fragments `labels` (H, W), 0 = none, at the surface's size."""
    few = np.ascontiguousarray(labels[::2, ::2])
    count = int(labels.max(initial=0)) + 1
    level_of = np.searchsorted(np.array(LEVELS) * ODDS_UNIT + ODDS_ZERO, np.arange(256), side="right")
    sums, levels = (np.zeros((count * count, _NUM_DISTANCES, *more), np.int32) for more in ((), (_NUM_LEVELS,)))
    inner, num_inner = np.zeros((2, count, _NUM_DISTANCES), np.int64)
    things = np.zeros((count, 2), np.int64)
    _add(few, odds.odds, np.array(OFFSETS), level_of, sums, levels, inner, num_inner, things)
    keys = np.flatnonzero(levels.any(axis=(1, 2)))
    return FragmentOdds(
        a=keys // count,
        b=keys % count,
        sums=sums[keys].astype(np.int64),
        levels=levels[keys].astype(np.int64),
        inner=inner,
        num_inner=num_inner,
        thing=things[:, 0].copy(),
        num_pixels=things[:, 1].copy(),
    )


@kernel
def _add(labels, odds, offsets, level_of, sums, levels, inner, num_inner, things):
    height, width = labels.shape
    count, num_distances = inner.shape
    last = len(offsets)
    for y in range(height):
        for x in range(width):
            label = labels[y, x]
            if label == 0:
                continue
            things[label, 0] += np.int64(odds[last, y, x]) - ODDS_ZERO
            things[label, 1] += 1
            for i in range(last):
                yy, xx = y + offsets[i, 0], x + offsets[i, 1]
                if yy >= height or xx < 0 or xx >= width:
                    continue
                other = labels[yy, xx]
                if other == 0:
                    continue
                byte = odds[i, y, x]
                distance = i * num_distances // last
                if other == label:
                    inner[label, distance] += np.int64(byte) - ODDS_ZERO
                    num_inner[label, distance] += 1
                    continue
                at = min(label, other) * count + max(label, other)
                sums[at, distance] += np.int32(byte) - ODDS_ZERO
                levels[at, distance, level_of[byte]] += 1
