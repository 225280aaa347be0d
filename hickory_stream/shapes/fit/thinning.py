"""Thinning of many samples to a stride, without aliasing with the rows of their grid."""

import numpy as np
from numpy.typing import NDArray

GOLDEN = 0.6180339887498949


def thinned(count: int, most: int) -> NDArray[np.int64]:
    """Return the indices of about `most` of `count` samples; all of them if there are fewer."""
    # One of each interval, at an offset by the golden ratio: a stride could hit one layer of a thin plate every time.
    if count <= most:
        return np.arange(count)
    n = np.arange(most)
    # The fraction of n times the golden ratio; exact, as the remainder is, which takes ten times as long.
    share = n * GOLDEN - np.floor(n * GOLDEN)
    return (count / most * (n + share)).astype(np.int64)
