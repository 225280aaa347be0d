"""Directions of small motions (K, 6): unit, a turn first, then a shift, along the axes of some frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry import portable

if TYPE_CHECKING:
    from numpy.typing import NDArray


def no_directions() -> NDArray[np.float64]:
    """Return none, (0, 6)."""
    return np.empty((0, 6))


def turned_directions(a_from_b: NDArray[np.float64], directions_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the same directions (K, 6) along the axes of another frame, by the rotation of a transform (4, 4)."""
    return portable.matmul(directions_b.reshape(-1, 2, 3), a_from_b[:3, :3].T).reshape(-1, 6)
