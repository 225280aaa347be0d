"""Features of pairs of regions from a network's odds, for the trees; NaN where the network has no output.

Mean log-odds between the two regions at every pixel distance, and their spread; the same within each region, where the
network may be uncertain; the difference to the best partner of either; the log-odds that each is an object.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.perception.affinity.pixel_network import DISTANCES_PX
from hickory_stream.perception.regions.features import Features, table
from hickory_stream.perception.regions.fragment_odds import NUM_NEAR, FragmentOdds, mean_log_odds

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
    sums, levels = odds.of_pairs(pairs, count)
    counts, sides, parts = levels.sum(axis=2), pairs.T, (slice(0, NUM_NEAR), slice(NUM_NEAR, None))
    numbers = [counts[:, part].sum(axis=1) for part in parts]
    # The highest mean log-odds of each region with any other.
    best, means = np.full(count, -np.inf), mean_log_odds(odds.sums.sum(axis=1), odds.levels.sum(axis=(1, 2)))
    for ends in (odds.a, odds.b):
        np.maximum.at(best, ends, means)
    rows = table(
        *(mean_log_odds(sums[:, part].sum(axis=1), number) for part, number in zip(parts, numbers, strict=True)),
        mean_log_odds(sums, counts).T,
        *(_shares(levels[:, part].sum(axis=1).T) for part in parts),
        *(number / np.sqrt(np.maximum(odds.num_pixels[sides[1]], 1)) for number in numbers),
        *(mean_log_odds(odds.inner[:, part].sum(axis=1), odds.num_inner[:, part].sum(axis=1))[sides] for part in parts),
        best[sides] - mean_log_odds(sums.sum(axis=1), counts.sum(axis=1)),
        mean_log_odds(odds.thing, odds.num_pixels)[sides],
    )
    return Features(ODDS_FEATURES, rows)


def _shares(levels: NDArray[np.int64]) -> NDArray[np.float64]:
    # (3, K) the shares of the lowest of (4, K) levels, of the lower half, and of the highest.
    number = levels.sum(axis=0)
    some = np.array((levels[0], levels[0] + levels[1], levels[3]))
    return np.where(number > 0, some / np.maximum(number, 1), np.nan)
