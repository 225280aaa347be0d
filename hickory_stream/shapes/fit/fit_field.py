"""The field that primitives are fitted to: signed distances in cells, and the explained share of each cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.portable_kernels import exp, log
from hickory_stream.shapes.connected import piece_around
from hickory_stream.shapes.fit.cell_shares import body_of, distance_bound, occupancies, occupancy
from hickory_stream.shapes.fit.quadric_lm import lm_fit
from hickory_stream.shapes.fit.seeds import chessboard_depth
from hickory_stream.shapes.fit.tangent_planes import BLOCK, DISTANCE, X, Y, Z, distances_of, fill_distances, new_block
from hickory_stream.shapes.fit.thinning import share_of, thinned
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
        return float(log(max(self._object.shape)))

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
        return float(_gain(self._object, self._covered, row, max_samples, self._waste_weight))

    def fitted(self, row: NDArray[np.float64], max_samples: int, iterations: int) -> NDArray[np.float64]:
        """Return the primitive fitted to the unexplained volume in its neighbourhood."""
        if self._speaking is None:
            self._speaking = _speaking(self._distance, self._covered, self._band)
        found = _fitted(
            row, *self._speaking, self._distance, self._covered, self._band, max_samples, iterations, self.max_log_axis
        )
        return np.asarray(found)


@kernel
def _window(row, margin, shape):
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for i in range(3):
        reach = margin
        for j in range(3):
            reach += abs(row[8 + 3 * i + j]) * exp(row[2 + j])
        low[i] = min(max(int(np.floor(row[5 + i] - reach)), 0), shape[i] - 1)
        high[i] = min(max(int(np.ceil(row[5 + i] + reach)) + 1, low[i] + 1), shape[i])
    return low, high


@kernel
def _gain(inside, covered, row, max_samples, waste_weight):
    low, high = _window(row, 1.0, inside.shape)
    stride = max((high[0] - low[0]) * (high[1] - low[1]) * (high[2] - low[2]) // max_samples, 1) | 1
    body = body_of(row)
    block = new_block()
    shares, befores = np.empty(BLOCK), np.empty(BLOCK)
    total, count = 0.0, 0
    # Cells, which of them their bounds are enough for, and what is known of them.
    cells, bounds = np.empty((3, BLOCK)), np.empty(BLOCK)
    own, known = np.empty(BLOCK, np.float32), np.empty(BLOCK, np.float32)
    size_y, size_z = high[1] - low[1], high[2] - low[2]
    size = (high[0] - low[0]) * size_y * size_z
    m, is_left = 0, True
    while is_left:
        num_cells = 0
        while num_cells < BLOCK and is_left:
            # One cell of each stride, at an offset that does not alias with the rows of the window.
            n = m * stride + int(stride * share_of(m))
            m += 1
            is_left = m * stride < size
            if n >= size:
                break
            line = n // size_z
            i, k = line // size_y, low[2] + n - line * size_z
            j = low[1] + line - i * size_y
            i += low[0]
            if covered[i, j, k] >= 1.0:
                continue
            cells[0, num_cells], cells[1, num_cells], cells[2, num_cells] = i, j, k
            own[num_cells], known[num_cells] = inside[i, j, k], covered[i, j, k]
            num_cells += 1
        for n in range(num_cells):
            bounds[n] = distance_bound(body, cells[0, n], cells[1, n], cells[2, n])
        for n in range(num_cells):
            if abs(bounds[n]) > 0.5:
                total += _gain_of(bounds[n], own[n], known[n], waste_weight)
                continue
            block[X + count], block[Y + count], block[Z + count] = cells[0, n], cells[1, n], cells[2, n]
            shares[count], befores[count] = own[n], known[n]
            count += 1
            if count == BLOCK:
                total += _gain_of_block(block, count, row, shares, befores, waste_weight)
                count = 0
    total += _gain_of_block(block, count, row, shares, befores, waste_weight)
    return total * stride


@kernel
def _gain_of_block(block, count, row, shares, befores, waste_weight):
    if count == 0:
        return 0.0
    fill_distances(block, count, row, 0.5)
    total = 0.0
    for n in range(count):
        total += _gain_of(block[DISTANCE + n], shares[n], befores[n], waste_weight)
    return total


@kernel
def _gain_of(d, share, before, waste_weight):
    after = max(occupancy(d), before)
    more = min(after, share) - min(before, share)
    return more - waste_weight * (max(after - share, 0.0) - max(before - share, 0.0))


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
def _fitted(row, speaking, starts, distance, covered, band, max_samples, iterations, max_log_axis):
    low, high = _window(row, band + 2.0, distance.shape)
    near = np.empty(len(speaking), np.int64)
    count = 0
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            line = i * distance.shape[1] + j
            for n in range(starts[line], starts[line + 1]):
                if low[2] <= speaking[n, 2] < high[2]:
                    near[count] = n
                    count += 1
    chosen = thinned(count, max_samples)
    count = len(chosen)
    if count < _FEWEST:
        return row
    points, distances, weights = np.empty((count, 3)), np.empty(count), np.empty(count)
    for n in range(count):
        i, j, k = speaking[near[chosen[n]]]
        points[n, 0], points[n, 1], points[n, 2] = i, j, k
        distances[n] = distance[i, j, k]
        weights[n] = 1.0 - np.float64(covered[i, j, k])
    return _trimmed(lm_fit(row, points, distances, weights, band, iterations, max_log_axis), distance, 2 * max_samples)


@kernel
def _trimmed(row, distance, max_samples):
    # Beyond the grid nothing limits the growth of a thin primitive.
    low, high = _window(row, 1.0, distance.shape)
    found = np.empty(((high[0] - low[0]) * (high[1] - low[1]) * (high[2] - low[2]), 3), np.int64)
    count = 0
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(low[2], high[2]):
                if distance[i, j, k] < np.float32(0.5):
                    found[count, 0], found[count, 1], found[count, 2] = i, j, k
                    count += 1
    chosen = thinned(count, max_samples)
    cells = np.empty((len(chosen), 3))
    for n in range(len(chosen)):
        for axis in range(3):
            cells[n, axis] = found[chosen[n], axis]
    own = distances_of(row, cells, np.inf)
    first, last = np.full(3, np.inf), np.full(3, -np.inf)
    for n in range(len(cells)):
        if own[n] < 0.5:
            x, y, z = cells[n, 0] - row[5], cells[n, 1] - row[6], cells[n, 2] - row[7]
            for axis in range(3):
                along = x * row[8 + axis] + y * row[11 + axis] + z * row[14 + axis]
                first[axis], last[axis] = min(first[axis], along), max(last[axis], along)
    if first[0] > last[0]:
        return row
    out = row.copy()
    for axis in range(3):
        half = exp(row[2 + axis])
        first[axis], last[axis] = max(first[axis] - 0.5, -half), min(last[axis] + 0.5, half)
        out[2 + axis] = log(max((last[axis] - first[axis]) / 2.0, 0.25))
    for i in range(3):
        shift = 0.0
        for axis in range(3):
            shift += row[8 + 3 * i + axis] * ((first[axis] + last[axis]) / 2.0)
        out[5 + i] = row[5 + i] + shift
    return out
