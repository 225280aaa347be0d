"""Initial primitives of the fit: boxes grown inside the unexplained volume, and bounds of whole components.

A box grown from a deep cell finds a table's top or a chair's leg; the bounds of their common component do not.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry import portable


def grown_box(solid: NDArray[np.bool_], seed: tuple[int, int, int], min_fill: float) -> NDArray[np.int64]:
    """Return (2, 3) the first and last cells of a box grown from `seed`, each new face filled by `min_fill`."""
    box = np.array([seed, seed], dtype=np.int64)
    _grow(solid, box, box.copy(), min_fill)
    return box


def chessboard_depth(solid: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the chessboard distance from each cell to the nearest one that is not solid; -1 if all are solid."""
    depth = np.asarray(_depth(solid))
    return depth if not solid.all() else np.full_like(depth, -1)


def principal_axes(cells: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return (3, 3) right-handed columns, the principal axes of (N, 3) cells."""
    places = cells.T.astype(np.float64)
    off = places - (places.sum(axis=1) / len(cells))[:, None]
    axes = portable.eigh(portable.matmul(off, off.T) / len(cells))[1]
    if portable.det3(axes) < 0:
        axes[:, 0] = -axes[:, 0]
    return axes


def bounds_along(cells: NDArray[np.int64], axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (2, 3) the least and the greatest coordinates of (N, 3) cells along the columns of `axes` (3, 3)."""
    along = portable.matmul(axes.T, cells.T.astype(np.float64))
    return np.stack([along.min(axis=1), along.max(axis=1)])


@kernel
def _grow(solid, box, layer, min_fill):
    # Side by side, as long as any grows; `layer` is room for the bounds of a side's next cells.
    blocked, growing = 0, True
    while growing:
        growing = False
        for n in range(6):
            side, axis = n // 3, n % 3
            if blocked >> n & 1:
                continue
            for i in range(3):
                layer[0, i], layer[1, i] = box[0, i], box[1, i]
            place = box[side, axis] + 2 * side - 1
            layer[0, axis], layer[1, axis] = place, place
            filled, total = 0, 0
            if 0 <= place < solid.shape[axis]:
                for i in range(layer[0, 0], layer[1, 0] + 1):
                    for j in range(layer[0, 1], layer[1, 1] + 1):
                        for k in range(layer[0, 2], layer[1, 2] + 1):
                            total += 1
                            filled += solid[i, j, k]
            if total > 0 and filled >= min_fill * total:
                box[side, axis] = place
                growing = True
            else:
                blocked |= 1 << n


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
