"""Layout of labels without overlap: of those that would cover one another the lowest stays, the others move up."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def rises(centers: NDArray[np.float64], sizes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (N,) how far up each label moves, so that no two of them overlap.

    `centers` (N, 2) with y down and `sizes` (N, 2), width and height, are in one unit, whichever it is.
    """
    half = np.asarray(sizes, dtype=np.float64) / 2
    found = np.zeros(len(centers))
    placed = np.empty((0, 4))
    for i in np.argsort(-centers[:, 1], kind="stable"):
        (x, y), (w, h) = centers[i], half[i]
        beside = placed[(placed[:, 0] < x + w) & (x - w < placed[:, 2])]
        # From the lowest up: each that is in the way is passed, and none that was passed can be met again.
        for _, top, _, bottom in beside[np.argsort(-beside[:, 3], kind="stable")]:
            if top < y + h and y - h < bottom:
                y = top - h
        found[i] = centers[i, 1] - y
        placed = np.vstack([placed, (x - w, y - h, x + w, y + h)])
    return found
