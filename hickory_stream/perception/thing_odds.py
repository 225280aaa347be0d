"""Whether a mask is a thing or part of the room, by the word of a network on all of its pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.fragment_odds import mean_log_odds
from hickory_stream.perception.pixel_network import ODDS_ZERO, THING

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.pixel_network import PixelOdds


def thing_log_odds(labels: NDArray[np.int32], odds: PixelOdds) -> NDArray[np.float64]:
    """Return (n + 1,) the mean log-odds of being a thing of the masks 0..n of an image (h, w).

    NaN where a mask has no pixel that the network, at half the size, has an output for.
    """
    few = labels[::2, ::2].ravel()
    count = int(labels.max(initial=0)) + 1
    from_even = odds.odds[THING].ravel().astype(np.float64) - ODDS_ZERO
    sums = np.bincount(few, weights=from_even, minlength=count).astype(np.int64)  # of whole numbers: exact
    return mean_log_odds(sums, np.bincount(few, minlength=count))
