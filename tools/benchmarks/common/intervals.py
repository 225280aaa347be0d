"""95 % confidence intervals: Wilson's of a share, the bootstrap of a statistic of rows."""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

_RESAMPLES = 2000


def wilson(found: int, total: int) -> tuple[float, float]:
    """Return the interval of Wilson's score for a share of `total` >= 1."""
    found_of = binomtest(found, total).proportion_ci(method="wilson")
    return float(found_of.low), float(found_of.high)


def bootstrap(
    groups: Sequence[NDArray[np.float64]], statistic: Callable[[Sequence[NDArray[np.float64]]], float]
) -> tuple[float, float]:
    """Return the 2.5th and 97.5th percentile of a statistic of groups of rows, each resampled with replacement."""
    # Each group keeps its size. The draws are seeded: the same rows give the same interval.
    random = np.random.default_rng(0)
    drawn = [
        statistic([group[random.integers(len(group), size=len(group))] if len(group) else group for group in groups])
        for _ in range(_RESAMPLES)
    ]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(low), float(high)
