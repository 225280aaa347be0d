"""Features of pairs of regions from a network's odds, for the trees; NaN where the network has no output.

Mean log-odds between the two regions at every pixel distance, and their spread; the same within each region, where the
network may be uncertain; the difference to the best partner of either; the log-odds that each is an object.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.perception.affinity.pixel_network import DISTANCES_PX, ODDS_UNIT
from hickory_stream.perception.regions.features import Features
from hickory_stream.perception.regions.fragment_odds import NUM_NEAR, FragmentOdds

_NUM_DISTANCES = len(DISTANCES_PX)
_SIDES = ("large", "small")
ODDS_FEATURES = (
    *("odds_near", "odds_far"),
    *(f"odds_at_{distance}" for distance in DISTANCES_PX),
    *(f"odds_{side}_{level}" for side in ("near", "far") for level in ("apart", "below_even", "one")),
    *("odds_near_share", "odds_far_share"),
    *(f"{side}_{name}" for name in ("odds_within", "odds_far_within") for side in _SIDES),
    *(f"{side}_odds_below_best" for side in _SIDES),
    *(f"{side}_thing_odds" for side in _SIDES),
)


def odds_features(odds: FragmentOdds | None, pairs: NDArray[np.int64], count: int) -> Features:
    """Return by name (K,) the features of (K, 2) pairs, large and small, of `count` regions; NaN without odds."""
    if odds is None:
        return Features(ODDS_FEATURES, np.full((len(pairs), len(ODDS_FEATURES)), np.nan))
    rows = np.empty((len(pairs), len(ODDS_FEATURES)))
    sums, levels = odds.of_pairs(pairs, count)
    best = _best(odds.a, odds.b, odds.sums, odds.levels, count)
    _fill(rows, pairs, sums, levels, odds.inner, odds.num_inner, odds.thing, odds.num_pixels, best)
    return Features(ODDS_FEATURES, rows)


@kernel(error_model="numpy")
def _fill(rows, pairs, sums, levels, inner, num_inner, thing, num_pixels, best):
    # Fill in a row of `ODDS_FEATURES` for each pair; counts of 0 give NaN.
    counts = np.empty(_NUM_DISTANCES, np.int64)
    for k in range(len(pairs)):
        row, small = rows[k], pairs[k, 1]
        for i in range(_NUM_DISTANCES):
            counts[i] = levels[k, i].sum()
            row[2 + i] = _mean(sums[k, i], counts[i])
        own = _mean(sums[k].sum(), counts.sum())
        at = 2 + _NUM_DISTANCES
        for part in range(2):
            distances = slice(0, NUM_NEAR) if part == 0 else slice(NUM_NEAR, _NUM_DISTANCES)
            number = counts[distances].sum()
            row[part] = _mean(sums[k, distances].sum(), number)
            for j in range(3):
                # Of the levels the lowest, the lower half, the highest.
                some = levels[k, distances, 3 if j == 2 else 0].sum()
                if j == 1:
                    some += levels[k, distances, 1].sum()
                row[at + 3 * part + j] = some / number if number > 0 else np.nan
            row[at + 6 + part] = number / np.sqrt(max(num_pixels[small], 1))
            for side in range(2):
                region = pairs[k, side]
                within = _mean(inner[region, distances].sum(), num_inner[region, distances].sum())
                row[at + 8 + 2 * part + side] = within
        for side in range(2):
            region = pairs[k, side]
            row[at + 12 + side] = best[region] - own if np.isfinite(own) else np.nan
            row[at + 14 + side] = _mean(thing[region], num_pixels[region])


@kernel(error_model="numpy")
def _best(a, b, sums, levels, count):
    # (count,) the highest mean log-odds of each region with any other.
    best = np.full(count, -np.inf)
    for n in range(len(a)):
        mean = _mean(sums[n].sum(), levels[n].sum())
        best[a[n]], best[b[n]] = max(best[a[n]], mean), max(best[b[n]], mean)
    return best


@kernel(error_model="numpy")
def _mean(total, count):
    # Mean log-odds from a sum of bytes relative to even odds; NaN where the count is 0.
    return total / (ODDS_UNIT * count) if count > 0 else np.nan
