"""Whether a mask is an object or part of the room, by the affinity network's log-odds over its pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.fragment_odds import mean_log_odds
from hickory_stream.perception.pixel_network import ODDS_ZERO, THING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.pixel_network import PixelOdds


def thing_log_odds(labels: NDArray[np.int32], odds: PixelOdds) -> NDArray[np.float64]:
    """Return (n + 1,) the mean log-odds that each mask 0..n of an image (h, w) is an object.

    NaN for a mask without a pixel in the network's output, which has half the resolution.
    """
    few = labels[::2, ::2].ravel()
    count = int(labels.max(initial=0)) + 1
    from_even = odds.odds[THING].ravel().astype(np.float64) - ODDS_ZERO
    sums = np.bincount(few, weights=from_even, minlength=count).astype(np.int64)  # sums of integers: exact
    return mean_log_odds(sums, np.bincount(few, minlength=count))
