"""Thinning of many samples to a stride, without aliasing with the rows of their grid."""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel


@kernel
def thinned(count, most):
    """Return the indices of about `most` of `count` samples; all of them if there are fewer."""
    # One of each interval, at an offset by the golden ratio: a stride could hit one layer of a thin plate every time.
    if count <= most:
        return np.arange(count)
    stride = count / most
    chosen = np.empty(most, np.int64)
    for n in range(most):
        chosen[n] = np.int64(stride * (n + share_of(n)))
    return chosen


@kernel
def share_of(n):
    """Return where in its interval the n-th sample is taken, 0..1: the fraction of n times the golden ratio."""
    golden = n * 0.6180339887498949
    # Exact, as the remainder is, which takes ten times as long.
    return golden - np.floor(golden)
