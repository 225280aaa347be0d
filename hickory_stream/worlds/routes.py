"""Routes over a floor with clearance from the objects on it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hickory_stream.worlds.clearance import CELL_M

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.clearance import Clearance


def way_between(clearance: Clearance, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return a short path (N, 2) with clearance between two positions, None if there is none."""
    from skimage.graph import route_through_array

    distance = clearance.distance_m
    cost = np.where(distance >= 0.2, 1.0 + 6.0 * np.maximum(0.0, 0.5 - distance) / 0.5, 1e6)
    cells, total = route_through_array(cost, clearance.cell(a), clearance.cell(b), geometric=True)
    if total >= 1e6:
        return None
    return clearance.origin_m + CELL_M * np.array(cells, dtype=np.float64)


def smoothed(route: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a closed route smoothed over about a third of a metre, to remove the steps of the grid."""
    line = gaussian_filter1d(route, 8.0, axis=0, mode="wrap")
    return np.vstack([line, line[:1]])
