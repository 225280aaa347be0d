"""Occupancy of floor cells for the centre of a body: free, occupied or unknown, over all of its height.

A cell is free if the centre may be anywhere in its closed square. Outlines of objects are counted per cell, so that an
update changes only an object's own cells. Rows lie along y, columns along x, as in nav_msgs/OccupancyGrid.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import InputError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.navigation.clearance import rows_of
from hickory_stream.navigation.outline import outlines_of_hulls, outlines_of_rows, stamp
from hickory_stream.navigation.robot import Part, grown

MOST_BYTES = 1 << 30
_BYTES_PER_CELL = 9


class Cell(IntEnum):
    """The state of a cell, with the values of nav_msgs/OccupancyGrid."""

    UNKNOWN = -1
    FREE = 0
    OCCUPIED = 100


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class GridFrame:
    """Where the cells are: `origin_m` (2,) is the low corner of the first one."""

    origin_m: NDArray[np.float64]
    cell_m: float
    rows: int
    columns: int

    def __post_init__(self) -> None:
        freeze(self, "origin_m", np.float64, (2,))

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.rows, self.columns

    @property
    def high_m(self) -> NDArray[np.float64]:
        """The (2,) high corner of the last cell."""
        return np.asarray(self.origin_m + self.cell_m * np.array([self.columns, self.rows]))

    def cells_of(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the (N, 2) row and column of (N, 2) points; they may lie outside."""
        return np.floor((np.asarray(points) - self.origin_m) / self.cell_m).astype(np.int64)[:, ::-1]

    def centers_m(self) -> NDArray[np.float64]:
        """Return the (rows, columns, 2) centres of the cells."""
        x = self.origin_m[0] + (np.arange(self.columns) + 0.5) * self.cell_m
        y = self.origin_m[1] + (np.arange(self.rows) + 0.5) * self.cell_m
        return np.stack(np.meshgrid(x, y), axis=-1)


def frame_around(
    low_m: NDArray[np.float64],
    high_m: NDArray[np.float64],
    cell_m: float,
    *,
    num_layers: int = 1,
    most_bytes: int = MOST_BYTES,
) -> GridFrame:
    """Return the cells that cover a rectangle, their corners at multiples of the cell.

    Raises:
        InputError: the cell size is not positive, or the grid would take more memory than allowed.
    """
    if not (np.isfinite(cell_m) and cell_m > 0):
        raise InputError(f"found a cell of {cell_m} m, expected a length above 0")
    first = np.floor(np.asarray(low_m)[:2] / cell_m)
    # As floats: a size that is rejected below may not fit into an integer.
    columns, rows = np.maximum(np.ceil(np.asarray(high_m)[:2] / cell_m) - first, 1)
    wanted = columns * rows * num_layers * _BYTES_PER_CELL
    if not wanted <= most_bytes:
        raise InputError(
            f"a grid of {columns:.0f} x {rows:.0f} cells of {cell_m:g} m in {num_layers} layers takes "
            f"{wanted / 2**20:,.0f} MiB, allowed are {most_bytes / 2**20:,.0f}; use larger cells"
        )
    return GridFrame(origin_m=first * cell_m, cell_m=cell_m, rows=int(rows), columns=int(columns))


class Occupancy:
    """The cells of one body in one heading: `parts` at heights of the world; hulls are grown by `hull_margin_m`."""

    def __init__(self, frame: GridFrame, parts: Sequence[Part], *, hull_margin_m: float = 0.0) -> None:
        self.frame = frame
        self._parts = tuple(parts)
        self._grown = tuple(grown(part, hull_margin_m) for part in parts)
        self._counts = np.zeros(frame.shape, np.int32)
        self._walls = np.zeros(frame.shape, np.int32)
        self._unknown = np.zeros(frame.shape, np.int32)
        self._outlines: dict[int, list[tuple[NDArray[np.float64], NDArray[np.int64]]]] = {}

    def put(self, object_id: int, inflated: Superquadrics) -> None:
        """Add or replace an object; raises ValueError if a primitive is not finite."""
        rows = rows_of(inflated)
        if not np.isfinite(rows).all():
            raise ValueError(f"object {object_id} has a superquadric that is not finite: it cannot be avoided")
        self._replace(object_id, [outlines_of_rows(rows, part) for part in self._parts])

    def put_hulls(self, object_id: int, hulls: NDArray[np.float64]) -> None:
        """Add an object that is the union of the convex hulls of (N, M, 3) points, or replace what it was."""
        if not np.isfinite(hulls).all():
            raise ValueError(f"object {object_id} has corners that are not finite: it cannot be avoided")
        self._replace(object_id, [outlines_of_hulls(hulls, part) for part in self._grown])

    def remove(self, object_id: int) -> None:
        """Remove an object; nothing happens where it is not there."""
        for corners, starts in self._outlines.pop(object_id, []):
            stamp(self._counts, corners, starts, self.frame.origin_m, self.frame.cell_m, -1)

    def observe(self, walls: NDArray[np.float64], unknown: NDArray[np.float64]) -> None:
        """Replace structure and unobserved space by hulls of (N, 8, 3) and (M, 8, 3) corners."""
        for counts, hulls in ((self._walls, walls), (self._unknown, unknown)):
            counts[:] = 0
            for part in self._grown:
                if len(hulls):
                    corners, starts = outlines_of_hulls(hulls, part)
                    stamp(counts, corners, starts, self.frame.origin_m, self.frame.cell_m, 1)

    def is_occupied(self) -> NDArray[np.bool_]:
        """Return (rows, columns) whether a body in the cell may collide with an object or structure."""
        return np.asarray((self._counts > 0) | (self._walls > 0))

    def states(self) -> NDArray[np.int8]:
        """Return (rows, columns) the `Cell` of each cell; occupied takes precedence over unknown."""
        unknown = np.where(self._unknown > 0, np.int8(Cell.UNKNOWN), np.int8(Cell.FREE))
        return np.where(self.is_occupied(), np.int8(Cell.OCCUPIED), unknown)

    def objects_at(self, row: int, column: int) -> list[int]:
        """Return the ids of the objects that a body in this cell would collide with."""
        found: list[int] = []
        if not self._counts[row, column]:
            return found
        for object_id, outlines in sorted(self._outlines.items()):
            counts = np.zeros(self.frame.shape, np.int32)
            for corners, starts in outlines:
                stamp(counts, corners, starts, self.frame.origin_m, self.frame.cell_m, 1)
            if counts[row, column]:
                found.append(object_id)
        return found

    def is_wall_at(self, row: int, column: int) -> bool:
        """Return whether a body in this cell would collide with structure."""
        return bool(self._walls[row, column])

    def _replace(self, object_id: int, outlines: list[tuple[NDArray[np.float64], NDArray[np.int64]]]) -> None:
        self.remove(object_id)
        for corners, starts in outlines:
            stamp(self._counts, corners, starts, self.frame.origin_m, self.frame.cell_m, 1)
        self._outlines[object_id] = outlines


def distance_field_m(is_blocked: NDArray[np.bool_], cell_m: float) -> NDArray[np.float32]:
    """Return (rows, columns) the least distance from a cell to a blocked one; infinite if no cell is blocked."""
    import cv2

    if not is_blocked.any():
        return np.full(is_blocked.shape, np.inf, np.float32)
    apart = cv2.distanceTransform((~is_blocked).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    # The transform is between cell centres; from border to border the distance is smaller by one diagonal.
    return np.asarray(np.maximum(apart - np.sqrt(2), 0) * np.float32(cell_m), dtype=np.float32)
