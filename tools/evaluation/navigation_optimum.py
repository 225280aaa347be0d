"""The exact shortest path over a grid (a visibility graph): the reference for the length of planned paths."""
# The shortest path around blocked squares is taut: it bends only at their convex corners, with the square on the inside
# of the bend (Lozano-Pérez and Wesley, 1979). It may touch squares, which the planners' paths may not, so its length is
# a lower bound of theirs.

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from hickory_stream.base.compiled import kernel
from hickory_stream.navigation.occupancy import GridFrame

_HAIR = 1e-6


class OptimalLengths:
    """The lengths of shortest paths over a grid of blocked cells; everything outside the grid is blocked."""

    def __init__(self, is_blocked: NDArray[np.bool_], frame: GridFrame) -> None:
        self._blocked = np.ascontiguousarray(is_blocked)
        self._frame = frame
        self._corners, self._sides = _bends(self._blocked)
        a, b, lengths = _edges(self._blocked, self._corners, self._sides)
        count = len(self._corners)
        # Two more nodes: start and goal.
        self._rows, self._columns, self._lengths = a, b, lengths
        self._size = count + 2

    def length_m(self, start: NDArray[np.float64], goal: NDArray[np.float64]) -> float:
        """Return the length of the shortest path between two points (2,), infinite if there is none."""
        ends = (np.array([start, goal]) - self._frame.origin_m) / self._frame.cell_m
        direct = float(np.linalg.norm(ends[1] - ends[0]))
        if _sees(self._blocked, ends[0, 0], ends[0, 1], ends[1, 0], ends[1, 1]):
            return direct * self._frame.cell_m
        rows, columns, lengths = [self._rows], [self._columns], [self._lengths]
        for n, end in enumerate(ends):
            seen, far = _seen_from(self._blocked, self._corners, self._sides, end)
            rows.append(np.full(len(seen), self._size - 2 + n))
            columns.append(seen)
            lengths.append(far)
        graph = coo_array(
            (np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), shape=(self._size, self._size)
        ).tocsr()
        found = dijkstra(graph, directed=False, indices=self._size - 2)[self._size - 1]
        return float(found) * self._frame.cell_m


@kernel
def _sees(blocked, x0, y0, x1, y1):
    rows, columns = blocked.shape
    if y1 < y0:
        x0, y0, x1, y1 = x1, y1, x0, y0
    first, last = int(np.floor(y0 + _HAIR)), int(np.floor(y1 - _HAIR))
    if last < first and 0 <= last and first < rows:
        # The segment runs along the line between two rows: it is blocked where both sides are.
        for i in range(
            max(int(np.floor(min(x0, x1) + _HAIR)), 0), min(int(np.floor(max(x0, x1) - _HAIR)) + 1, columns)
        ):
            if blocked[last, i] and blocked[first, i]:
                return False
    first, last = max(first, 0), min(last, rows - 1)
    slope = (x1 - x0) / (y1 - y0) if y1 > y0 else 0.0
    for j in range(first, last + 1):
        xa = x0 if y0 >= j else x0 + slope * (j - y0)
        xb = x1 if y1 <= j + 1 else x0 + slope * (j + 1 - y0)
        left, right = int(np.floor(min(xa, xb) + _HAIR)), int(np.floor(max(xa, xb) - _HAIR))
        for i in range(max(left, 0), min(right, columns - 1) + 1):
            if blocked[j, i]:
                return False
        if right < left and 0 <= right and left < columns and blocked[j, right] and blocked[j, left]:
            return False
        # Two blocked squares that touch at a corner leave no gap between them.
        if j < last:
            x = x0 + slope * (j + 1 - y0)
            i = int(np.round(x))
            if abs(x - i) < _HAIR and 0 < i < columns:
                pair, other = blocked[j, i - 1] and blocked[j + 1, i], blocked[j, i] and blocked[j + 1, i - 1]
                if pair or other:
                    return False
    return True


def _bends(blocked: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
    around = np.pad(blocked, 1, constant_values=True)
    low_left, low_right = around[:-1, :-1], around[:-1, 1:]
    high_left, high_right = around[1:, :-1], around[1:, 1:]
    count = low_left.astype(int) + low_right + high_left + high_right
    rows, columns = np.nonzero(count == 1)
    sides = np.where(low_left[rows, columns] | high_right[rows, columns], 1, -1)
    return np.column_stack([columns, rows]).astype(np.float64), sides.astype(np.int8)


@kernel
def _is_taut(side, dx, dy):
    return side * dx * dy <= 0.0


@kernel
def _edges(blocked, corners, sides):
    most = 1024
    count = 0
    a, b, lengths = np.empty(most, np.int64), np.empty(most, np.int64), np.empty(most)
    for m in range(len(corners)):
        for n in range(m):
            dx, dy = corners[m, 0] - corners[n, 0], corners[m, 1] - corners[n, 1]
            if not (_is_taut(sides[m], dx, dy) and _is_taut(sides[n], dx, dy)):
                continue
            if not _sees(blocked, corners[n, 0], corners[n, 1], corners[m, 0], corners[m, 1]):
                continue
            if count == most:
                most *= 2
                a = np.concatenate((a, np.empty(count, np.int64)))
                b = np.concatenate((b, np.empty(count, np.int64)))
                lengths = np.concatenate((lengths, np.empty(count)))
            a[count], b[count], lengths[count] = m, n, np.sqrt(dx * dx + dy * dy)
            count += 1
    return a[:count].copy(), b[:count].copy(), lengths[:count].copy()


@kernel
def _seen_from(blocked, corners, sides, place):
    seen, far = np.empty(len(corners), np.int64), np.empty(len(corners))
    count = 0
    for n in range(len(corners)):
        dx, dy = corners[n, 0] - place[0], corners[n, 1] - place[1]
        if _is_taut(sides[n], dx, dy) and _sees(blocked, place[0], place[1], corners[n, 0], corners[n, 1]):
            seen[count], far[count] = n, np.sqrt(dx * dx + dy * dy)
            count += 1
    return seen[:count].copy(), far[:count].copy()
