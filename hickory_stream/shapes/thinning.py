"""Thinning of many samples to a stride, without aliasing with the rows of the grid that they come from."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def thinned(count: int, most: int) -> NDArray[np.int64]:
    """Return the indices of about `most` of `count` samples; all of them if there are fewer.

    One sample of each interval is taken, at an offset by the golden ratio: a constant stride through the cells of a
    thin plate could hit the same layer every time.
    """
    if count <= most:
        return np.arange(count)
    stride = count / most
    n = np.arange(most)
    return np.asarray((stride * (n + (n * 0.6180339887498949) % 1.0)).astype(np.int64))
