"""The field that primitives are fitted to: signed distances in cells, and the explained share of each cell."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import exp, exp_each, log
from hickory_stream.shapes.connected import piece_around
from hickory_stream.shapes.fit.cell_shares import body_of, distance_bound, occupancies, occupancy
from hickory_stream.shapes.fit.quadric_lm import refined
from hickory_stream.shapes.fit.seeds import chessboard_depth
from hickory_stream.shapes.fit.tangent_planes import BLOCK, DISTANCE, X, Y, Z, distances_of, fill_distances, new_block
from hickory_stream.shapes.fit.thinning import GOLDEN, thinned
from hickory_stream.shapes.sdf import DistanceGrid

# A fit has eleven parameters.
_FEWEST = 11


class FitField:
    """An object's signed distances, and the cover so far; `waste_weight` penalises volume outside the object."""

    def __init__(self, grid: DistanceGrid, waste_weight: float) -> None:
        self._distance = (grid.values / grid.step_m).astype(np.float32)
        # Occupancy is linear within half a cell of the surface: a plate of 2.1 cells counts as 2.1.
        self._object = np.clip(0.5 - self._distance, 0, 1).astype(np.float32)
        self._covered = np.zeros_like(self._object)
        self._waste_weight = waste_weight
        self._band = grid.band_m / grid.step_m
        self._occupancies: dict[bytes, NDArray[np.float32]] = {}
        self._speaking: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None
        self._band_cells: NDArray[np.int64] | None = None
        self._workspace = (new_block(), np.empty((8, BLOCK)))
        self.volume = float(self._object.sum(dtype=np.float64))

    @property
    def solid(self) -> NDArray[np.bool_]:
        """The cells inside the object."""
        return self._distance < 0

    @property
    def left(self) -> NDArray[np.bool_]:
        """The cells inside the object that no primitive explains."""
        return (self._distance < 0) & (self._object - self._covered > 0.5)

    @property
    def band(self) -> float:
        """The distance at which the signed distances are truncated, in cells."""
        return self._band

    @property
    def longest_side(self) -> int:
        """The cells along the longest side of the grid."""
        return max(self._object.shape)

    @property
    def max_log_axis(self) -> float:
        """The logarithm of the maximum semi-axis, in cells."""
        return float(log(float(max(self._object.shape))))

    def unexplained(self) -> float:
        """Return the volume of the object that no primitive explains, in cells."""
        return float(np.maximum(self._object - self._covered, 0).sum(dtype=np.float64))

    def overlap(self) -> float:
        """Return the intersection over union of the object and the primitives that cover it."""
        both = np.minimum(self._object, self._covered).sum(dtype=np.float64)
        either = np.maximum(self._object, self._covered).sum(dtype=np.float64)
        return float(both / max(either, 1e-300))

    def samples(self, max_samples: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the (N, 3) cells within the band of the surface, evenly thinned out, and their (N,) distances."""
        if self._band_cells is None:
            self._band_cells = np.argwhere(np.abs(self._distance) < self._band)
        cells = self._band_cells[thinned(len(self._band_cells), max_samples)]
        return cells.astype(np.float64), self._distance[tuple(cells.T)].astype(np.float64)

    def protruding_part(self, min_reach: float) -> NDArray[np.int64] | None:
        """Return the (N, 3) cells of the part that protrudes farthest from all primitives; None below `min_reach`."""
        unexplained = self._covered < 0.5
        reach = np.where(self._distance < 0, chessboard_depth(unexplained), 0.0)
        farthest = np.unravel_index(int(np.argmax(reach)), reach.shape)
        if reach[farthest] < min_reach:
            return None
        i, j, k = (int(n) for n in farthest)
        is_reaching = (self._distance < 0) & (reach > 1.0)
        # Whatever does not reach so far itself is one with all that does not.
        return np.argwhere(piece_around(is_reaching, i, j, k) if is_reaching[farthest] else ~is_reaching)

    def cover_with(self, rows: list[NDArray[np.float64]]) -> None:
        """Set the cover to exactly these primitives."""
        self._covered[...] = 0
        for row in rows:
            self.consume(row)

    def consume(self, row: NDArray[np.float64]) -> None:
        """Remove the volume that a primitive explains from the unexplained volume."""
        low, high = _window(row, 1.0, self._object.shape)
        key = row.tobytes()
        if key not in self._occupancies:
            self._occupancies[key] = occupancies(row, low, high)
        part = self._covered[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        np.maximum(part, self._occupancies[key], out=part)
        self._speaking = None

    def gain(self, row: NDArray[np.float64], max_samples: int) -> float:
        """Return the explained volume that a primitive adds, less the penalty, by about `max_samples` cells."""
        body, window = body_of(row), _window(row, 1.0, self._object.shape)
        workspace = self._workspace
        return float(_gain(self._object, self._covered, row, body, window, max_samples, self._waste_weight, *workspace))

    def fitted(self, row: NDArray[np.float64], max_samples: int, iterations: int) -> NDArray[np.float64]:
        """Return the primitive fitted to the unexplained volume in its neighbourhood."""
        if self._speaking is None:
            self._speaking = _speaking(self._distance, self._covered, self._band)
        cells, starts = self._speaking
        near = np.empty(len(cells), np.int64)
        near = near[
            : _fill_near(cells, starts, _window(row, self._band + 2.0, self._object.shape), self._object.shape[1], near)
        ]
        near = near[thinned(len(near), max_samples)]
        if len(near) < _FEWEST:
            return row
        at = tuple(cells[near].T)
        found = refined(
            row,
            cells[near].astype(np.float64),
            self._distance[at].astype(np.float64),
            1.0 - self._covered[at].astype(np.float64),
            band=self._band,
            iterations=iterations,
            max_log_axis=self.max_log_axis,
        )
        return self._trimmed(found, 2 * max_samples)

    def _trimmed(self, row: NDArray[np.float64], max_samples: int) -> NDArray[np.float64]:
        # Beyond the grid nothing limits the growth of a thin primitive.
        low, high = _window(row, 1.0, self._object.shape)
        part = self._distance[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        found = np.flatnonzero(part < np.float32(0.5))
        found = found[thinned(len(found), max_samples)]
        line, k = np.divmod(found, part.shape[2])
        i, j = np.divmod(line, part.shape[1])
        cells = np.stack([i + low[0], j + low[1], k + low[2]], axis=1).astype(np.float64)
        own = cells[distances_of(row, cells, np.inf) < 0.5]
        if len(own) == 0:
            return row
        along = portable.matmul(row[8:17].reshape(3, 3).T, (own - row[5:8]).T)
        half = exp_each(row[2:5])
        first, last = np.maximum(along.min(axis=1) - 0.5, -half), np.minimum(along.max(axis=1) + 0.5, half)
        out = row.copy()
        out[2:5] = portable.log(np.maximum((last - first) / 2.0, 0.25))
        out[5:8] += portable.matmul(row[8:17].reshape(3, 3), (first + last) / 2.0)
        return out


def _window(row: NDArray[np.float64], margin: float, shape: tuple[int, ...]) -> NDArray[np.int64]:
    # (2, 3) the first cells and the ends of a primitive's bounds and a margin.
    window = np.empty((2, 3), np.int64)
    _fill_window(row, margin, shape, window)
    return window


@kernel
def _fill_window(row, margin, shape, window):
    for i in range(3):
        reach = margin
        for j in range(3):
            reach += abs(row[8 + 3 * i + j]) * exp(row[2 + j])
        window[0, i] = min(max(int(np.floor(row[5 + i] - reach)), 0), shape[i] - 1)
        window[1, i] = min(max(int(np.ceil(row[5 + i] + reach)) + 1, window[0, i] + 1), shape[i])


@kernel
def _gain(inside, covered, row, body, window, max_samples, waste_weight, block, room):
    # `room` (8, BLOCK): cells, their shares, and how far they are covered, of a round and of the block.
    size_y, size_z = window[1, 1] - window[0, 1], window[1, 2] - window[0, 2]
    size = (window[1, 0] - window[0, 0]) * size_y * size_z
    stride = max(size // max_samples, 1) | 1
    total, count, m, is_left = 0.0, np.int64(0), 0, True
    while is_left:
        num_cells = 0
        while num_cells < BLOCK and is_left:
            # One cell of each stride, at an offset that does not alias with the rows of the window.
            share = m * GOLDEN
            n = m * stride + int(stride * (share - np.floor(share)))
            m += 1
            is_left = m * stride < size
            if n >= size:
                break
            line = n // size_z
            i, k = line // size_y, window[0, 2] + n - line * size_z
            j = window[0, 1] + line - i * size_y
            i += window[0, 0]
            if covered[i, j, k] >= 1.0:
                continue
            room[0, num_cells], room[1, num_cells], room[2, num_cells] = i, j, k
            room[3, num_cells], room[4, num_cells] = inside[i, j, k], covered[i, j, k]
            num_cells += 1
        for n in range(num_cells):
            room[5, n] = distance_bound(body, room[0, n], room[1, n], room[2, n])
        for n in range(num_cells):
            own, known = room[3, n], room[4, n]
            if abs(room[5, n]) > 0.5:
                # In the precision of the cover.
                over = np.float64(np.float32(known) - np.float32(own))
                total += _gain_of(room[5, n], own, known, over, waste_weight)
                continue
            block[X + count], block[Y + count], block[Z + count] = room[0, n], room[1, n], room[2, n]
            room[6, count], room[7, count] = own, known
            count += 1
            if count == BLOCK:
                total += _gain_of_block(block, count, row, room, waste_weight)
                count = np.int64(0)
    if count > 0:
        total += _gain_of_block(block, count, row, room, waste_weight)
    return total * stride


@kernel
def _gain_of_block(block, count, row, room, waste_weight):
    fill_distances(block, count, row, 0.5)
    total = 0.0
    for n in range(count):
        own, known = room[6, n], room[7, n]
        total += _gain_of(block[DISTANCE + n], own, known, known - own, waste_weight)
    return total


@kernel
def _gain_of(d, share, before, over, waste_weight):
    after = max(occupancy(d), before)
    more = min(after, share) - min(before, share)
    return more - waste_weight * (max(after - share, 0.0) - max(over, 0.0))


@kernel
def _speaking(distance, covered, band):
    # (N, 3) cells near the surface and one in eight deep inside, and where those of each row along z begin.
    out = np.empty((distance.size, 3), np.int64)
    starts = np.empty(distance.shape[0] * distance.shape[1] + 1, np.int64)
    count = 0
    for i in range(distance.shape[0]):
        for j in range(distance.shape[1]):
            starts[i * distance.shape[1] + j] = count
            for k in range(distance.shape[2]):
                if distance[i, j, k] >= band or covered[i, j, k] >= 0.95:
                    continue
                if distance[i, j, k] > -0.99 * band or (i % 2 == 0 and j % 2 == 0 and k % 2 == 0):
                    out[count, 0], out[count, 1], out[count, 2] = i, j, k
                    count += 1
    starts[-1] = count
    return out[:count].copy(), starts


@kernel
def _fill_near(cells, starts, window, size_y, near):
    # Which cells lie in the window; returns their number.
    count = 0
    for i in range(window[0, 0], window[1, 0]):
        for j in range(window[0, 1], window[1, 1]):
            for n in range(starts[i * size_y + j], starts[i * size_y + j + 1]):
                if window[0, 2] <= cells[n, 2] < window[1, 2]:
                    near[count] = n
                    count += 1
    return count
