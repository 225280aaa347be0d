"""Sparse voxels as sorted int64 keys on one lattice, anchored at the world origin.

A key packs three 21-bit cell coordinates, so that sorting keys sorts cells and a set operation is a merge.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import read_only

_BITS = 21
_OFFSET = 1 << (_BITS - 1)
_MASK = (1 << _BITS) - 1
# What a key gains from one voxel to the next along each axis.
STEP_X, STEP_Y, STEP_Z = 1 << (2 * _BITS), 1 << _BITS, 1
_NONE = np.empty(0, dtype=np.int64)


def keys_of_cells(cells: NDArray[Any]) -> NDArray[np.int64]:
    """Return (N,) keys of (N, 3) integer cells, each coordinate within +-2^20."""
    c = cells.astype(np.int64) + _OFFSET
    return (c[:, 0] << (2 * _BITS)) | (c[:, 1] << _BITS) | c[:, 2]


def cells_of_keys(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (N, 3) integer cells of (N,) keys."""
    return np.asarray(_cells_of_keys(read_only(keys)))


def layers_of_keys(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (N,) third coordinates of the cells of (N,) keys: their heights."""
    return (keys & _MASK) - _OFFSET


def rows_of_keys(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the (N,) second coordinates of the cells of (N,) keys."""
    return ((keys >> _BITS) & _MASK) - _OFFSET


def bounds_of_keys(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the lowest and the highest cell (3,) of (N,) keys, coordinate by coordinate; at least one key."""
    fields = (keys >> (2 * _BITS), (keys >> _BITS) & _MASK, keys & _MASK)
    return tuple(np.array([of(field) for field in fields]) - _OFFSET for of in (np.min, np.max))  # type: ignore[return-value]


def keys_of_points(points: NDArray[Any], voxel_m: float) -> NDArray[np.int64]:
    """Return the (N,) keys of the voxels that hold (N, 3) finite points; neither sorted nor unique."""
    return _keys_of_points(read_only(points), float(voxel_m))


def centers_of_keys(keys: NDArray[np.int64], voxel_m: float) -> NDArray[np.float32]:
    """Return the (N, 3) centres of the voxels of (N,) keys."""
    return ((cells_of_keys(keys) + 0.5) * voxel_m).astype(np.float32)


def contains(sorted_keys: NDArray[np.int64], queries: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return for each query whether it is among the sorted keys; quickest where queries are near those before them."""
    return _contains(read_only(sorted_keys), read_only(queries))


def are_near(sorted_keys: NDArray[np.int64], queries: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return for each query whether its voxel, or one of the 26 around it, is among the sorted keys, as `contains`."""
    return _are_near(read_only(sorted_keys), read_only(queries))


def places(sorted_keys: NDArray[np.int64], queries: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what np.searchsorted does: before which of the sorted keys each query belongs."""
    return _places(read_only(sorted_keys), read_only(queries))


def coarse_keys(keys: NDArray[np.int64], halvings: int) -> NDArray[np.int64]:
    """Return (N,) the keys of the first voxels of the cells, 2^halvings voxels a side, in which (N,) voxels lie."""
    low = (1 << halvings) - 1
    return keys & ~np.int64((low << (2 * _BITS)) | (low << _BITS) | low)


def difference(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted keys of `a` that are not in `b`, both sorted; `a` itself where none of `b` are in it."""
    return exchanged(a, b, _NONE)


def union(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted keys of `a` and `b`, both sorted and each key once; `a` itself where `b` brings no new ones."""
    return exchanged(a, _NONE, b)


def exchanged(a: NDArray[np.int64], gone: NDArray[np.int64], new: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the union of `new` and the difference of `a` and `gone`, all sorted, in one walk; `a` where it is that."""
    keys = read_only(a)
    at_gone, at_new, fresh = _changes(keys, read_only(gone), read_only(new))
    if len(at_gone) + len(fresh) == 0:
        return a
    return np.asarray(_exchanged(keys, at_gone, at_new, fresh))


def sorted_unique(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what np.unique does; a sort of integers takes a fraction of the time of its hash table."""
    ordered = np.sort(keys)
    return ordered[np.flatnonzero(np.diff(ordered, prepend=ordered[:1] - 1))]


@kernel
def row_of_key(key):
    """Return the second coordinate of the cell of a key."""
    return ((key >> _BITS) & _MASK) - _OFFSET


@kernel
def cell_of_key(key):
    """Return the cell of a key: its three coordinates."""
    return ((key >> (2 * _BITS)) & _MASK) - _OFFSET, row_of_key(key), (key & _MASK) - _OFFSET


@kernel
def key_of_point(x, y, z, voxel_m):
    """Return the key of the voxel that holds a finite point."""
    i = np.int64(np.floor(np.float64(x) / voxel_m)) + _OFFSET
    j = np.int64(np.floor(np.float64(y) / voxel_m)) + _OFFSET
    k = np.int64(np.floor(np.float64(z) / voxel_m)) + _OFFSET
    return (i << (2 * _BITS)) | (j << _BITS) | k


@kernel
def _cells_of_keys(keys):
    out = np.empty((len(keys), 3), dtype=np.int64)
    for i in range(len(keys)):
        out[i, 0], out[i, 1], out[i, 2] = cell_of_key(keys[i])
    return out


@kernel
def _keys_of_points(points, voxel_m):
    out = np.empty(len(points), dtype=np.int64)
    for i in range(len(points)):
        out[i] = key_of_point(points[i, 0], points[i, 1], points[i, 2], voxel_m)
    return out


@kernel
def first_not_below(sorted_keys, key, start):
    """Return the place of the first of the sorted keys that is not below `key`, sought outwards from `start`."""
    count = len(sorted_keys)
    step = 1
    if start < count and sorted_keys[start] < key:
        low, high = start, start + 1
        while high < count and sorted_keys[high] < key:
            low = high
            step *= 2
            high = low + step
        high = min(high, count)
    else:
        low, high = start - 1, start
        while low >= 0 and sorted_keys[low] >= key:
            high = low
            low -= step
            step *= 2
        low = max(low, -1)
    while high - low > 1:
        middle = (low + high) >> 1
        if sorted_keys[middle] < key:
            low = middle
        else:
            high = middle
    return high


@kernel
def _places(sorted_keys, queries):
    out = np.empty(len(queries), dtype=np.int64)
    at = np.int64(0)
    for i in range(len(queries)):
        at = first_not_below(sorted_keys, queries[i], at)
        out[i] = at
    return out


@kernel
def _contains(sorted_keys, queries):
    out = np.empty(len(queries), dtype=np.bool_)
    at = np.int64(0)
    for i in range(len(queries)):
        at = first_not_below(sorted_keys, queries[i], at)
        out[i] = at < len(sorted_keys) and sorted_keys[at] == queries[i]
    return out


@kernel
def _changes(a, gone, new):
    # A key that goes and comes stays, as in a difference and a union after it. Places ascend also where keys do not, as
    # in an altered journal: `_exchanged` writes by them.
    # Zeros of a type, not literals, for which `first_not_below` would be compiled once more.
    at_gone, num_gone, at = np.empty(len(gone), dtype=np.int64), 0, np.int64(0)
    for i in range(len(gone)):
        at = first_not_below(a, gone[i], at)
        if at < len(a) and a[at] == gone[i] and (num_gone == 0 or at > at_gone[num_gone - 1]):
            at_gone[num_gone] = at
            num_gone += 1
    at_new, fresh = np.empty(len(new), dtype=np.int64), np.empty(len(new), dtype=np.int64)
    num_fresh, at, g = 0, np.int64(0), 0
    for i in range(len(new)):
        at = first_not_below(a, new[i], at)
        if at < len(a) and a[at] == new[i]:
            while g < num_gone and at_gone[g] < at:
                g += 1
            if g == num_gone or at_gone[g] != at:
                continue
        if num_fresh == 0 or at >= at_new[num_fresh - 1]:
            at_new[num_fresh], fresh[num_fresh] = at, new[i]
            num_fresh += 1
    return at_gone[:num_gone], at_new[:num_fresh], fresh[:num_fresh]


@kernel
def _are_near(sorted_keys, queries):
    # A step of one cell along an axis adds a constant to the packed key, and along z neighbours are next to each other
    # in the sorted keys: nine searches cover 27 cells. Each search starts where its last one ended.
    found = np.zeros(len(queries), dtype=np.bool_)
    ends = np.zeros(9, dtype=np.int64)
    for i in range(len(queries)):
        for side in range(9):
            # The cell's own column first: it usually decides.
            dx, dy = (side + 1) % 3 - 1, (side // 3 + 1) % 3 - 1
            low = queries[i] + (dx << (2 * _BITS)) + (dy << _BITS) - 1
            at = first_not_below(sorted_keys, low, ends[side])
            ends[side] = at
            if at < len(sorted_keys) and sorted_keys[at] <= low + 2:
                found[i] = True
                break
    return found


@kernel
def _exchanged(a, gone, at, new):
    out = np.empty(len(a) - len(gone) + len(new), dtype=a.dtype)
    start, n, g, f = 0, 0, 0, 0
    while g < len(gone) or f < len(new):
        puts = g == len(gone) or (f < len(new) and at[f] <= gone[g])
        place = at[f] if puts else gone[g]
        for i in range(start, place):
            out[n] = a[i]
            n += 1
        start = place
        if puts:
            out[n] = new[f]
            n += 1
            f += 1
        else:
            start += 1
            g += 1
    for i in range(start, len(a)):
        out[n] = a[i]
        n += 1
    return out


def dilate(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted keys of all voxels within one cell (26 neighbours) of the given ones."""
    cells = cells_of_keys(keys)
    steps = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.unique(keys_of_cells((cells[:, None, :] + steps[None]).reshape(-1, 3)))


def without_outliers(points: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which of (N, 3) points lie in cells of 4 cm with at least four; all where few cells are so dense.

    A box goes around these: quantiles would cut off a table's legs, a small share of its points.
    """
    dense = sums_of_equal(keys_of_points(points, 0.04)) >= 4
    return dense if dense.mean() > 0.7 else np.ones(len(points), dtype=bool)


def sums_of_equal(keys: NDArray[np.int64], weights: NDArray[np.int64] | None = None) -> NDArray[np.int64]:
    """Return for each of (N,) keys the sum of the weights of equal keys, or their number without weights."""
    groups, distinct = groups_of(keys)
    totals = np.zeros(len(distinct), dtype=np.int64)
    return _sums(groups, totals, np.ones(0, dtype=np.int64) if weights is None else weights)


def groups_of(keys: NDArray[np.int64]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return (N,) the number of each key's group, and the (groups,) keys, in the order in which they come first."""
    return _groups_of(read_only(keys))


@kernel
def _groups_of(keys):
    # A hash table with open addressing, at most half full.
    bits = 4
    while (1 << bits) < 2 * len(keys):
        bits += 1
    mask = np.int64((1 << bits) - 1)
    table = np.full(1 << bits, np.int32(-1), dtype=np.int32)
    groups = np.empty(len(keys), dtype=np.int32)
    distinct = np.empty(len(keys), dtype=np.int64)
    count = np.int32(0)
    last = np.int32(0)
    for i in range(len(keys)):
        key = keys[i]
        if i > 0 and key == keys[i - 1]:
            groups[i] = last
            continue
        # Fibonacci hashing, with the product's upper half folded down: neighbours in x differ in high bits only.
        spread = key * np.int64(-7046029254386353131)
        slot = (spread ^ (spread >> 32)) & mask
        while table[slot] >= 0 and distinct[table[slot]] != key:
            slot = (slot + 1) & mask
        if table[slot] < 0:
            table[slot] = count
            distinct[count] = key
            count += np.int32(1)
        last = table[slot]
        groups[i] = last
    return groups, distinct[:count]


@kernel
def _sums(groups, totals, weights):
    for i in range(len(groups)):
        totals[groups[i]] += weights[i] if len(weights) else 1
    out = np.empty(len(groups), dtype=np.int64)
    for i in range(len(groups)):
        out[i] = totals[groups[i]]
    return out
