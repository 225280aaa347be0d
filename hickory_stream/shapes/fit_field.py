"""The field that primitives are fitted to: signed distances in cells, and how much of each cell is explained."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from hickory_stream.compiled import numba
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import exp, exp_each, log, log1p, power
from hickory_stream.shapes.quadric_lm import distances_to, refined, tangent_distance
from hickory_stream.shapes.seeds import chessboard_depth
from hickory_stream.shapes.tangent_planes import BLOCK, DISTANCE, X, Y, Z, fill_distances, new_block
from hickory_stream.shapes.thinning import thinned

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.shapes.sdf import DistanceGrid


class FitField:
    """An object's signed distances, and the cover by the primitives so far.

    `waste_weight` is the penalty on volume of primitives outside the object.
    """

    def __init__(self, grid: DistanceGrid, waste_weight: float) -> None:
        self._distance = (grid.values / grid.step_m).astype(np.float32)
        # Occupancy is linear within half a cell of the surface: a plate of 2.1 cells counts as 2.1.
        self._object = np.clip(0.5 - self._distance, 0, 1).astype(np.float32)
        self._covered = np.zeros_like(self._object)
        self._waste_weight = waste_weight
        self._band = grid.band_m / grid.step_m
        self._occupancies: dict[bytes, NDArray[np.float32]] = {}
        self._speaking: NDArray[np.int64] | None = None
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
        labels, _ = ndimage.label((self._distance < 0) & (reach > 1.0))
        return np.argwhere(labels == labels[farthest])

    def cover_with(self, rows: list[NDArray[np.float64]]) -> None:
        """Set the cover to that of exactly these primitives."""
        self._covered[...] = 0
        for row in rows:
            self.consume(row)

    def consume(self, row: NDArray[np.float64]) -> None:
        """Remove the volume that a primitive explains from the unexplained volume."""
        low, high = self._window(row, 1.0)
        key = row.tobytes()
        if key not in self._occupancies:
            self._occupancies[key] = _occupancies(row, low, high)
        part = self._covered[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        np.maximum(part, self._occupancies[key], out=part)
        self._speaking = None

    def gain(self, row: NDArray[np.float64], max_samples: int) -> float:
        """Return the explained volume that a primitive adds, minus the penalty on volume outside the object, in cells.

        It is estimated from about `max_samples` cells if the primitive's window has more.
        """
        low, high = self._window(row, 1.0)
        stride = max(int(np.prod(high - low)) // max_samples, 1) | 1
        return float(_gain(self._object, self._covered, row, low, high, stride, self._waste_weight))

    def fitted(self, row: NDArray[np.float64], max_samples: int, iterations: int) -> NDArray[np.float64]:
        """Return the primitive fitted to the unexplained volume in its neighbourhood."""
        if self._speaking is None:
            self._speaking = _speaking(self._distance, self._covered, self._band)
        low, high = self._window(row, self._band + 2)
        cells = _within(self._speaking, low, high)
        cells = cells[thinned(len(cells), max_samples)]
        if len(cells) < 11:
            return row
        i, j, k = cells.T
        fit = refined(
            row,
            cells.astype(np.float64),
            self._distance[i, j, k].astype(np.float64),
            1.0 - self._covered[i, j, k].astype(np.float64),
            band=self._band,
            iterations=iterations,
            max_log_axis=self.max_log_axis,
        )
        return self.trimmed(fit, max_samples)

    def trimmed(self, row: NDArray[np.float64], max_samples: int) -> NDArray[np.float64]:
        """Return the primitive cut back, along its own axes, to the part of the object that lies in it.

        Distances are only known on the grid: beyond it nothing limits the growth of a thin primitive.
        """
        low, high = self._window(row, 1.0)
        found = _cells_below(self._distance, low, high, np.float32(0.5))
        cells = found[thinned(len(found), 2 * max_samples)].astype(np.float64)
        if len(cells) == 0:
            return row
        inside = cells[distances_to(row, cells) < 0.5]
        if len(inside) == 0:
            return row
        axes = row[8:17].reshape(3, 3)
        local = portable.matmul(inside - row[5:8], axes)
        half = portable.exp(row[2:5])
        first, last = np.maximum(local.min(axis=0) - 0.5, -half), np.minimum(local.max(axis=0) + 0.5, half)
        out = row.copy()
        out[2:5] = portable.log(np.maximum((last - first) / 2, 0.25))
        out[5:8] = row[5:8] + portable.matmul(axes, (first + last) / 2)
        return out

    def _window(self, row: NDArray[np.float64], margin: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the first cells and the ends of the part of the grid within `margin` of the box of a primitive."""
        return _window(row, margin, self._object.shape)


@numba.njit(cache=True, nogil=True)
def _window(row, margin, shape):  # type: ignore[no-untyped-def] # pragma: no cover
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    for i in range(3):
        reach = margin
        for j in range(3):
            reach += abs(row[8 + 3 * i + j]) * exp(row[2 + j])
        low[i] = min(max(int(np.floor(row[5 + i] - reach)), 0), shape[i] - 1)
        high[i] = min(max(int(np.ceil(row[5 + i] + reach)) + 1, low[i] + 1), shape[i])
    return low, high


@numba.njit(cache=True, nogil=True)
def _occupancy(d):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the share of a cell within a primitive, linear near its surface."""
    return min(max(0.5 - d, 0.0), 1.0)


@numba.njit(cache=True, nogil=True)
def _distance(row, x, y, z, axes, within, local, gradient, shape):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the signed distance of a cell to a primitive; beyond half a cell no more than a lower bound of its size.

    `axes` = exp(row[2:5]); `within` is the inscribed box, in shares of them.
    """
    d = _bound(row, x, y, z, axes, within)
    if abs(d) > 0.5:
        return d
    # Inside, the distance to a tangent plane is no lower bound.
    return max(tangent_distance(row, x, y, z, local, gradient, shape, False, 0.5), -0.5)


@numba.njit(cache=True, nogil=True)
def _bound(row, x, y, z, axes, within):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return a bound of a cell's distance without logarithms: beyond half a cell, in or out; 0 if there is none."""
    dx, dy, dz = x - row[5], y - row[6], z - row[7]
    u = abs(row[8] * dx + row[11] * dy + row[14] * dz)
    v = abs(row[9] * dx + row[12] * dy + row[15] * dz)
    w = abs(row[10] * dx + row[13] * dy + row[16] * dz)
    # Most cells need no logarithm: outside the box is outside; deep in the inscribed box or octahedron (exponents up
    # to 1, ellipsoid) is inside. A gauge changes by at most 1 / inradius per cell.
    outside = max(u - axes[0], v - axes[1], w - axes[2])
    if outside > 0.5:
        return outside
    inside = min(within * axes[0] - u, within * axes[1] - v, within * axes[2] - w)
    u, v, w = u / axes[0], v / axes[1], w / axes[2]
    smallest = min(axes[0], axes[1], axes[2])
    if row[0] <= 1.0 and row[1] <= 1.0:
        inside = max(inside, (1.0 - np.sqrt(u * u + v * v + w * w)) * smallest)
    else:
        inside = max(inside, (1.0 - u - v - w) * smallest / 1.7320508)
    return -inside if inside > 0.5 else 0.0


@numba.njit(cache=True, nogil=True)
def _inscribed(row):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return s such that the box of s times the semi-axes touches the primitive with its corners."""
    return exp(-0.5 * row[0] * log1p(power(2.0, row[1] / row[0])))


@numba.njit(cache=True, nogil=True)
def _occupancies(row, low, high):  # type: ignore[no-untyped-def] # pragma: no cover
    out = np.empty((high[0] - low[0], high[1] - low[1], high[2] - low[2]), np.float32)
    local, gradient, shape = np.empty(3), np.empty(3), np.empty(5)
    axes, within = exp_each(row[2:5]), _inscribed(row)
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            k = low[2]
            while k < high[2]:
                d = _distance(row, i, j, k, axes, within, local, gradient, shape)
                # Between adjacent cells the distance changes by at most 1: cells after a far one can be skipped.
                end = min(k + 1 + int(max(abs(d) - 0.5, 0.0)), high[2])
                out[i - low[0], j - low[1], k - low[2] : end - low[2]] = _occupancy(d)
                k = end
    return out


@numba.njit(cache=True, nogil=True)
def _gain(inside, covered, row, low, high, stride, waste_weight):  # type: ignore[no-untyped-def] # pragma: no cover
    axes, within = exp_each(row[2:5]), _inscribed(row)
    block = new_block()
    shares, befores = np.empty(BLOCK), np.empty(BLOCK)
    total, count = 0.0, 0
    size_y, size_z = high[1] - low[1], high[2] - low[2]
    size = (high[0] - low[0]) * size_y * size_z
    for m in range((size + stride - 1) // stride):
        # One cell of each stride, at an offset that does not alias with the rows of the window.
        n = m * stride + int(stride * ((m * 0.6180339887498949) % 1.0))
        if n >= size:
            break
        i = low[0] + n // (size_y * size_z)
        j = low[1] + (n // size_z) % size_y
        k = low[2] + n % size_z
        before = covered[i, j, k]
        if before >= 1.0:
            continue
        d = _bound(row, i, j, k, axes, within)
        if abs(d) > 0.5:
            total += _gain_of(d, inside[i, j, k], before, waste_weight)
            continue
        block[X + count], block[Y + count], block[Z + count] = i, j, k
        shares[count], befores[count] = inside[i, j, k], before
        count += 1
        if count == BLOCK:
            total += _gain_of_block(block, count, row, shares, befores, waste_weight)
            count = 0
    total += _gain_of_block(block, count, row, shares, befores, waste_weight)
    return total * stride


@numba.njit(cache=True, nogil=True)
def _gain_of_block(block, count, row, shares, befores, waste_weight):  # type: ignore[no-untyped-def] # pragma: no cover
    if count == 0:
        return 0.0
    fill_distances(block, count, row, 0.5)
    total = 0.0
    for n in range(count):
        total += _gain_of(block[DISTANCE + n], shares[n], befores[n], waste_weight)
    return total


@numba.njit(cache=True, nogil=True)
def _gain_of(d, share, before, waste_weight):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the gain of one cell at a distance `d`, of which the object fills a `share` and `before` is covered."""
    after = max(_occupancy(d), before)
    more = min(after, share) - min(before, share)
    return more - waste_weight * (max(after - share, 0.0) - max(before - share, 0.0))


@numba.njit(cache=True, nogil=True)
def _speaking(distance, covered, band):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the (N, 3) cells used for a fit: those near the surface, and one in eight of those deep inside."""
    out = np.empty((distance.size, 3), np.int64)
    count = 0
    for i in range(distance.shape[0]):
        for j in range(distance.shape[1]):
            for k in range(distance.shape[2]):
                if distance[i, j, k] >= band or covered[i, j, k] >= 0.95:
                    continue
                if distance[i, j, k] > -0.99 * band or (i % 2 == 0 and j % 2 == 0 and k % 2 == 0):
                    out[count, 0], out[count, 1], out[count, 2] = i, j, k
                    count += 1
    return out[:count].copy()


@numba.njit(cache=True, nogil=True)
def _cells_below(distance, low, high, limit):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the (N, 3) cells of a window whose distance is below a limit."""
    out = np.empty(((high[0] - low[0]) * (high[1] - low[1]) * (high[2] - low[2]), 3), np.int64)
    count = 0
    for i in range(low[0], high[0]):
        for j in range(low[1], high[1]):
            for k in range(low[2], high[2]):
                if distance[i, j, k] < limit:
                    out[count, 0], out[count, 1], out[count, 2] = i, j, k
                    count += 1
    return out[:count].copy()


@numba.njit(cache=True, nogil=True)
def _within(cells, low, high):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the cells within a window."""
    chosen = np.empty(len(cells), np.int64)
    count = 0
    for n in range(len(cells)):
        i, j, k = cells[n]
        if low[0] <= i < high[0] and low[1] <= j < high[1] and low[2] <= k < high[2]:
            chosen[count] = n
            count += 1
    return cells[chosen[:count]]
