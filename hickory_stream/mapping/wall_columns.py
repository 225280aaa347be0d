"""Columns of voxels, and which of them are walls': a wall goes on above the floor that it stands on, a floor does not.

What the core concludes of a floor (`observed_space`) and what is told of a map's floor (`floor_notes`) both leave out
the columns of walls, by this one rule.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

WALL_M = 0.6
"""So high above a level a column is looked at."""

# Of that height, a column of a wall has structure along this share at least: the rest is seen through or not at all.
_WALL_SHARE = 0.5


def column_starts(cells: NDArray[Any]) -> NDArray[np.int64]:
    """Return where each column begins in (N, 3) voxels that are ordered by x, y, z, as keys are."""
    if len(cells) == 0:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(np.append(True, (cells[1:, :2] != cells[:-1, :2]).any(axis=1)))


def column_sizes(starts: NDArray[np.int64], num_voxels: int) -> NDArray[np.int64]:
    """Return how many of the voxels each column has."""
    return np.diff(np.append(starts, num_voxels))


def is_wall_column(num_structure: NDArray[np.int64], voxel_m: float) -> NDArray[np.bool_]:
    """Return which columns, of so many voxels of structure within `WALL_M` above a level, are those of a wall."""
    return num_structure * voxel_m >= _WALL_SHARE * WALL_M
