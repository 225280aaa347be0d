"""Columns of voxels, and which of them belong to walls: a wall continues above the height of the floor.

The floor model of the core (`observed_space`) and the notes on a map's floor (`floor_notes`) both exclude the columns
of walls by this rule.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

WALL_M = 0.6
"""The height above a level up to which a column is examined."""

# Minimum share of that height along which a column of a wall has structure: the rest may be unobserved.
_WALL_SHARE = 0.5


def column_starts(cells: NDArray[Any]) -> NDArray[np.int64]:
    """Return the index at which each column begins in (N, 3) voxels that are sorted by x, y, z, like keys."""
    if len(cells) == 0:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(np.append(True, (cells[1:, :2] != cells[:-1, :2]).any(axis=1)))


def column_sizes(starts: NDArray[np.int64], num_voxels: int) -> NDArray[np.int64]:
    """Return the number of voxels in each column."""
    return np.diff(np.append(starts, num_voxels))


def is_wall_column(num_structure: NDArray[np.int64], voxel_m: float) -> NDArray[np.bool_]:
    """Return which columns belong to a wall, from their numbers of structure voxels within `WALL_M` above a level."""
    return num_structure * voxel_m >= _WALL_SHARE * WALL_M
