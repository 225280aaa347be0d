"""Sparse voxels as sorted int64 keys on one lattice.

All keys share one lattice, anchored at the world origin: two objects overlap in the same cells whichever was seen
first. A key packs three 21-bit cell coordinates, so that sorting keys sorts cells and a set operation is a merge.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numba
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BITS = 21
_OFFSET = 1 << (_BITS - 1)
_MASK = (1 << _BITS) - 1


def keys_of_cells(cells: NDArray[Any]) -> NDArray[np.int64]:
    """Return (N,) keys of (N, 3) integer cells, each coordinate within +-2^20."""
    c = cells.astype(np.int64) + _OFFSET
    return (c[:, 0] << (2 * _BITS)) | (c[:, 1] << _BITS) | c[:, 2]


def cells_of_keys(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (N, 3) integer cells of (N,) keys."""
    return np.stack([(keys >> (2 * _BITS)) & _MASK, (keys >> _BITS) & _MASK, keys & _MASK], axis=1) - _OFFSET


def layers_of_keys(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (N,) third coordinates of the cells of (N,) keys: their heights."""
    return (keys & _MASK) - _OFFSET


def keys_of_points(points: NDArray[Any], voxel_m: float) -> NDArray[np.int64]:
    """Return the (N,) keys of the voxels that hold (N, 3) points; neither sorted nor unique."""
    return keys_of_cells(np.floor(points.astype(np.float64) / voxel_m).astype(np.int64))


def centers_of_keys(keys: NDArray[np.int64], voxel_m: float) -> NDArray[np.float32]:
    """Return the (N, 3) centres of the voxels of (N,) keys."""
    return ((cells_of_keys(keys) + 0.5) * voxel_m).astype(np.float32)


def contains(sorted_keys: NDArray[np.int64], queries: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return for each query whether it is among the sorted keys."""
    if len(sorted_keys) == 0:
        return np.zeros(len(queries), dtype=bool)
    at = np.searchsorted(sorted_keys, queries)
    return sorted_keys[np.minimum(at, len(sorted_keys) - 1)] == queries


def difference(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted keys of `a` that are not in `b`, both sorted; quick where few of `b` are in `a`."""
    return np.asarray(_without_places(a, np.searchsorted(a, b[contains(a, b)])))


def union(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted keys of `a` and `b`, both sorted and each key once; quick where `b` brings few new ones."""
    fresh = b[~contains(a, b)]
    return np.asarray(_with_inserted(a, np.searchsorted(a, fresh), fresh)) if len(fresh) else a


@numba.njit(cache=True, nogil=True)
def _without_places(a, places):  # type: ignore[no-untyped-def] # pragma: no cover
    out = np.empty(len(a) - len(places), dtype=np.int64)
    start, n = 0, 0
    for place in places:
        out[n : n + place - start] = a[start:place]
        n += place - start
        start = place + 1
    out[n:] = a[start:]
    return out


@numba.njit(cache=True, nogil=True)
def _with_inserted(a, places, values):  # type: ignore[no-untyped-def] # pragma: no cover
    out = np.empty(len(a) + len(values), dtype=np.int64)
    start, n = 0, 0
    for i in range(len(places)):
        place = places[i]
        out[n : n + place - start] = a[start:place]
        n += place - start
        out[n] = values[i]
        n += 1
        start = place
    out[n:] = a[start:]
    return out


def dilate(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted keys of all voxels within one cell (26 neighbours) of the given ones."""
    cells = cells_of_keys(keys)
    steps = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.unique(keys_of_cells((cells[:, None, :] + steps[None]).reshape(-1, 3)))


def overlap_share(smaller: NDArray[np.int64], larger_dilated: NDArray[np.int64]) -> float:
    """Return the share of `smaller`'s voxels that lie in `larger_dilated` (sorted); 0.0 when there are none."""
    return float(contains(larger_dilated, smaller).mean()) if len(smaller) else 0.0


def in_company(points: NDArray[Any], cell_m: float = 0.04, min_points: int = 4) -> NDArray[np.bool_]:
    """Return for each of (N, 3) points whether its cell holds at least `min_points`; all of them where few cells do.

    What a box is put around: stray points have no company, whereas quantiles cut off a table's legs, which are a small
    share of its points.
    """
    _, inverse, counts = np.unique(keys_of_points(points, cell_m), return_inverse=True, return_counts=True)
    dense = counts[inverse] >= min_points
    return dense if dense.mean() > 0.7 else np.ones(len(points), dtype=bool)
