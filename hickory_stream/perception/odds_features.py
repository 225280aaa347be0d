"""Features of pairs of regions from a network's odds, from which trees estimate whether the two are one object.

They are: mean log-odds between the two regions at every pixel distance, and their spread; the same within each region
(where the network is uncertain within an object, low odds at a contact mean little); the difference to the best partner
of either region; and the log-odds that each is an object. NaN where the network has no output.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.fragment_odds import far_of, mean_log_odds, near_of
from hickory_stream.perception.pixel_network import DISTANCES_PX

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.fragment_odds import FragmentOdds

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
"""The names of `odds_features`, in their order."""


def odds_features(odds: FragmentOdds | None, pairs: NDArray[np.int64], count: int) -> dict[str, NDArray[np.float64]]:
    """Return by name (K,) the features of (K, 2) pairs, large and small, of `count` regions; NaN without odds."""
    if odds is None:
        return {name: np.full(len(pairs), np.nan) for name in ODDS_FEATURES}
    large, small = pairs.T
    sums, levels = odds.of_pairs(pairs, count)
    counts = levels.sum(axis=2)
    found = [mean_log_odds(near_of(sums), near_of(counts)), mean_log_odds(far_of(sums), far_of(counts))]
    found += [mean_log_odds(sums[:, i], counts[:, i]) for i in range(len(DISTANCES_PX))]
    for of_level in (near_of(levels), far_of(levels)):
        all_of = of_level.sum(axis=1)
        found += [_share(n, all_of) for n in (of_level[:, 0], of_level[:, :2].sum(axis=1), of_level[:, -1])]
    root = np.sqrt(np.maximum(odds.num_pixels[small], 1))
    found += [near_of(counts) / root, far_of(counts) / root]
    for part in (near_of, far_of):
        within = mean_log_odds(part(odds.inner), part(odds.num_inner))
        found += [within[large], within[small]]
    all_pairs = np.stack([odds.a, odds.b], axis=1)
    every = mean_log_odds(odds.sums.sum(axis=1), odds.levels.sum(axis=(1, 2)))
    best = np.full(count, -np.inf)
    for side in (0, 1):
        np.maximum.at(best, all_pairs[:, side], every)
    own = mean_log_odds(sums.sum(axis=1), counts.sum(axis=1))
    known = np.isfinite(own)
    found += [np.where(known, best[side], np.nan) - own for side in (large, small)]
    thing = mean_log_odds(odds.thing, odds.num_pixels)
    found += [thing[large], thing[small]]
    return dict(zip(ODDS_FEATURES, found, strict=True))


def _share(some: NDArray[np.int64], all_of: NDArray[np.int64]) -> NDArray[np.float64]:
    return np.where(all_of > 0, some / np.maximum(all_of, 1), np.nan)
