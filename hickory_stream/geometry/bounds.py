"""The least and greatest coordinates of points; NumPy takes several times as long along the columns of rows."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import read_only


def bounds_of(points: NDArray[Any]) -> NDArray[Any]:
    """Return (2, 3) the least and greatest coordinates of (N, 3) points, N >= 1, in their own precision."""
    assert len(points) > 0
    return _bounds_of(read_only(points))


def extent_of(points: NDArray[Any]) -> NDArray[Any]:
    """Return (3,) how far (N, 3) points reach along each axis, N >= 1, in their own precision."""
    low, high = bounds_of(points)
    return np.asarray(high - low)


@kernel
def _bounds_of(points):
    bounds = np.empty((2, 3), dtype=points.dtype)
    for k in range(3):
        bounds[0, k] = bounds[1, k] = points[0, k]
    for i in range(1, len(points)):
        for k in range(3):
            bounds[0, k], bounds[1, k] = min(bounds[0, k], points[i, k]), max(bounds[1, k], points[i, k])
    return bounds
