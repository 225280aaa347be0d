"""Colours of the voxels of surfaces as bytes that compress: each as how it differs from its neighbours'.

Neighbours in space are more alike than those next to one another in the order of keys: a ninth less than with
`packing.color_planes`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry.voxels import keys_of_cells

if TYPE_CHECKING:
    from numpy.typing import NDArray

_STEP_X, _STEP_Y, _ = (int(step) for step in keys_of_cells(np.eye(3)) - keys_of_cells(np.zeros((3, 3))))


def packed_colors(keys: NDArray[np.int64], colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (3, N) what is left of the (N, 3) colours of voxels of strictly ascending keys: red, green, blue.

    Red and blue as what they differ from green.
    """
    left: NDArray[np.uint8] = np.empty((3, len(keys)), dtype=np.uint8)
    _pack(keys, colors, left)
    return left


def unpacked_colors(keys: NDArray[np.int64], left: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the (N, 3) colours of which `packed_colors` gave what is left."""
    colors = np.empty((len(keys), 3), dtype=np.uint8)
    _unpack(keys, left, colors)
    return colors


@numba.njit(cache=True, nogil=True)
def _expected(keys, colors, i, beside, behind):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return what the neighbours of voxel `i` say of its red, green and blue, and the places to go on at.

    Neighbours are the voxel below, and those one step along x and one along y, or just below or above one of these.
    """
    key = keys[i]
    while beside < i and keys[beside] < key - _STEP_X:
        beside += 1
    while behind < i and keys[behind] < key - _STEP_Y:
        behind += 1
    count, red, green, blue = 0, np.int64(0), np.int64(0), np.int64(0)
    if i > 0 and keys[i - 1] == key - 1:
        count, red, green, blue = 1, np.int64(colors[i - 1, 0]), np.int64(colors[i - 1, 1]), np.int64(colors[i - 1, 2])
    for at, wanted in ((beside, key - _STEP_X), (behind, key - _STEP_Y)):
        if at < i and keys[at] <= wanted + 1:
            found = at
        elif at > 0 and keys[at - 1] == wanted - 1:
            found = at - 1
        else:
            continue
        count += 1
        red += colors[found, 0]
        green += colors[found, 1]
        blue += colors[found, 2]
    if count == 0 and i > 0:
        count, red, green, blue = 1, np.int64(colors[i - 1, 0]), np.int64(colors[i - 1, 1]), np.int64(colors[i - 1, 2])
    if count == 2:
        red, green, blue = red >> 1, green >> 1, blue >> 1
    elif count == 3:
        red, green, blue = red // 3, green // 3, blue // 3
    return red, green, blue, beside, behind


@numba.njit(cache=True, nogil=True)
def _pack(keys, colors, left):  # type: ignore[no-untyped-def] # pragma: no cover
    beside, behind = 0, 0
    for i in range(len(keys)):
        red, green, blue, beside, behind = _expected(keys, colors, i, beside, behind)
        off = np.int64(colors[i, 1]) - green
        left[0, i] = (np.int64(colors[i, 0]) - red - off) & 255
        left[1, i] = off & 255
        left[2, i] = (np.int64(colors[i, 2]) - blue - off) & 255


@numba.njit(cache=True, nogil=True)
def _unpack(keys, left, colors):  # type: ignore[no-untyped-def] # pragma: no cover
    beside, behind = 0, 0
    for i in range(len(keys)):
        red, green, blue, beside, behind = _expected(keys, colors, i, beside, behind)
        off = np.int64(left[1, i])
        colors[i, 0] = (np.int64(left[0, i]) + off + red) & 255
        colors[i, 1] = (off + green) & 255
        colors[i, 2] = (np.int64(left[2, i]) + off + blue) & 255
