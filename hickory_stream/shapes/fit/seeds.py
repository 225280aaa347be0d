"""Initial primitives of the fit: boxes grown inside the unexplained volume, and bounds of whole components.

A box grown from a deep cell finds a table's top or a chair's leg; the bounds of their common component do not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import diagonalise


def grown_box(solid: NDArray[np.bool_], seed: tuple[int, int, int], min_fill: float) -> NDArray[np.int64]:
    """Return (2, 3) the first and last cells of a box grown from `seed`, each new face filled by `min_fill`."""
    return np.asarray(_grow(solid, np.array(seed, dtype=np.int64), min_fill))


def chessboard_depth(solid: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the chessboard distance from each cell to the nearest one that is not solid; -1 if all are solid."""
    depth = np.asarray(_depth(solid))
    return depth if not solid.all() else np.full_like(depth, -1)


def principal_axes(cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (3, 3) right-handed columns, the principal axes of (N, 3) cells."""
    axes = np.asarray(_principal_axes(np.ascontiguousarray(cells, np.int64)))
    if portable.det3(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return axes


@kernel
def _principal_axes(cells):
    middle, products, axes = np.zeros(3), np.zeros((3, 3)), np.empty((3, 3))
    for n in range(len(cells)):
        for i in range(3):
            middle[i] += cells[n, i]
    middle /= len(cells)
    for n in range(len(cells)):
        x, y, z = cells[n, 0] - middle[0], cells[n, 1] - middle[1], cells[n, 2] - middle[2]
        off = (x, y, z)
        for i in range(3):
            for j in range(3):
                products[i, j] += off[i] * off[j]
    products /= len(cells)
    diagonalise(products, axes)
    return axes


@kernel
def bounds_along(cells, axes):
    """Return (2, 3) the least and the greatest coordinates of (N, 3) cells along the columns of `axes` (3, 3)."""
    bounds = np.empty((2, 3))
    bounds[0], bounds[1] = np.inf, -np.inf
    for n in range(len(cells)):
        x, y, z = np.float64(cells[n, 0]), np.float64(cells[n, 1]), np.float64(cells[n, 2])
        for i in range(3):
            along = x * axes[0, i] + y * axes[1, i] + z * axes[2, i]
            bounds[0, i], bounds[1, i] = min(bounds[0, i], along), max(bounds[1, i], along)
    return bounds


@kernel
def _grow(solid, seed, min_fill):
    box = np.empty((2, 3), np.int64)
    box[0], box[1] = seed, seed
    blocked = np.zeros((2, 3), np.bool_)
    growing = True
    while growing:
        growing = False
        for side in range(2):
            for axis in range(3):
                if blocked[side, axis]:
                    continue
                layer = box[side, axis] + (1 if side else -1)
                if layer < 0 or layer >= solid.shape[axis]:
                    blocked[side, axis] = True
                    continue
                low, high = box[0].copy(), box[1].copy()
                low[axis], high[axis] = layer, layer
                filled, total = 0, 0
                for i in range(low[0], high[0] + 1):
                    for j in range(low[1], high[1] + 1):
                        for k in range(low[2], high[2] + 1):
                            total += 1
                            filled += solid[i, j, k]
                if filled >= min_fill * total:
                    box[side, axis] = layer
                    growing = True
                else:
                    blocked[side, axis] = True
    return box


@kernel
def _depth(solid):
    # Rosenfeld and Pfaltz: one pass forwards, one backwards; each looks at the 13 neighbours before a cell.
    nx, ny, nz = solid.shape
    far = np.int32(nx + ny + nz)
    # The rim has the maximum depth: cells beyond the grid are not known to be empty.
    depth = np.full((nx + 2, ny + 2, nz + 2), far, np.int32)
    for i in range(1, nx + 1):
        for j in range(1, ny + 1):
            for k in range(1, nz + 1):
                if not solid[i - 1, j - 1, k - 1]:
                    depth[i, j, k] = 0
                    continue
                least = depth[i, j, k - 1]
                for w in range(k - 1, k + 2):
                    least = min(least, depth[i, j - 1, w], depth[i - 1, j - 1, w], depth[i - 1, j, w])
                    least = min(least, depth[i - 1, j + 1, w])
                depth[i, j, k] = min(least + 1, far)
    for i in range(nx, 0, -1):
        for j in range(ny, 0, -1):
            for k in range(nz, 0, -1):
                if depth[i, j, k] == 0:
                    continue
                least = depth[i, j, k + 1]
                for w in range(k - 1, k + 2):
                    least = min(least, depth[i, j + 1, w], depth[i + 1, j + 1, w], depth[i + 1, j, w])
                    least = min(least, depth[i + 1, j - 1, w])
                depth[i, j, k] = min(depth[i, j, k], least + 1)
    return depth[1:-1, 1:-1, 1:-1].copy()
