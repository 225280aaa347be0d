"""Where a primitive may begin: boxes grown inside what is not explained yet, and the bounds of whole components.

A box that grows from a deep cell until its faces leave the object finds a table's top and a chair's leg at once, where
the bounds of their common component say nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numba
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def grown_box(solid: NDArray[np.bool_], seed: tuple[int, int, int], min_fill: float) -> NDArray[np.int64]:
    """Return (2, 3) the first and last cells of a box grown from `seed`, each new face filled by `min_fill`."""
    return np.asarray(_grow(solid, np.array(seed, dtype=np.int64), min_fill))


def principal_axes(cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (3, 3) right-handed columns, the principal axes of (N, 3) cells."""
    centered = cells - cells.mean(axis=0)
    _, axes = np.linalg.eigh(centered.T @ centered / len(cells))
    if np.linalg.det(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return np.asarray(axes)


@numba.njit(cache=True, nogil=True)
def _grow(solid, seed, min_fill):  # type: ignore[no-untyped-def] # pragma: no cover
    box = np.empty((2, 3), np.int64)
    box[0], box[1] = seed, seed
    blocked = np.zeros((2, 3), np.bool_)
    growing = True
    while growing:
        growing = False
        for side in range(2):
            for axis in range(3):
                if blocked[side, axis]:
                    continue
                layer = box[side, axis] + (1 if side else -1)
                if layer < 0 or layer >= solid.shape[axis]:
                    blocked[side, axis] = True
                    continue
                low, high = box[0].copy(), box[1].copy()
                low[axis], high[axis] = layer, layer
                filled, total = 0, 0
                for i in range(low[0], high[0] + 1):
                    for j in range(low[1], high[1] + 1):
                        for k in range(low[2], high[2] + 1):
                            total += 1
                            filled += solid[i, j, k]
                if filled >= min_fill * total:
                    box[side, axis] = layer
                    growing = True
                else:
                    blocked[side, axis] = True
    return box
