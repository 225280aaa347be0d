"""Colours of voxels as bytes that compress, by their neighbours in space: a ninth less than by those in keys."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import read_only
from hickory_stream.geometry.codecs.packing import colors_of
from hickory_stream.geometry.voxels import keys_of_cells

_ROW_BYTES, _MEAN_BYTES = 12, 10


def unpacked_means(data: bytes, count: int) -> NDArray[np.float32]:
    """Return (N, 3) mean colours of journals until 2026-11; raises ValueError where there are not as many.

    Each is a sum over a number, and the last bits in which the order of adding shows; others are stored as they are.
    """
    if len(data) < _MEAN_BYTES * count:
        raise ValueError(f"{count} mean colours in {len(data)} bytes")
    numbers = np.frombuffer(data, np.uint8, _MEAN_BYTES * count)
    whole = colors_of(data[: 3 * count], count).astype(np.int64)
    hits = numbers[3 * count : 4 * count]
    rest, off = (numbers[at * count : (at + 3) * count].reshape(3, count).T.astype(np.int32) for at in (4, 7))
    is_kept = hits == 0
    if len(data) != _MEAN_BYTES * count + _ROW_BYTES * np.count_nonzero(is_kept):
        raise ValueError(f"{count} mean colours in {len(data)} bytes")
    counts = np.maximum(hits, 1)[:, None].astype(np.int64)
    means = ((whole * counts + rest) / counts).astype(np.float32)
    means = (means.view(np.int32) + ((off >> 1) ^ -(off & 1))).view(np.float32)
    means[is_kept] = np.frombuffer(data, "<f4", offset=_MEAN_BYTES * count).reshape(-1, 3)
    return means


_STEP_X, _STEP_Y, _ = (int(step) for step in keys_of_cells(np.eye(3)) - keys_of_cells(np.zeros((3, 3))))


def packed_colors(keys: NDArray[np.int64], colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (3, N) residuals of (N, 3) colours of voxels of strictly ascending keys: red and blue against green."""
    left: NDArray[np.uint8] = np.empty((3, len(keys)), dtype=np.uint8)
    _pack(read_only(keys), np.array(colors, order="C"), left)
    return left


def unpacked_colors(keys: NDArray[np.int64], left: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the (N, 3) colours of the residuals that `packed_colors` gave."""
    colors = np.empty((len(keys), 3), dtype=np.uint8)
    _unpack(read_only(keys), read_only(left), colors)
    return colors


@kernel
def _expected(keys, colors, i, beside, behind):
    # Neighbours are the voxel below, and those one step along x and y, or just below or above one of these.
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


@kernel
def _pack(keys, colors, left):
    beside, behind = np.int64(0), np.int64(0)
    for i in range(len(keys)):
        red, green, blue, beside, behind = _expected(keys, colors, i, beside, behind)
        off = np.int64(colors[i, 1]) - green
        left[0, i] = (np.int64(colors[i, 0]) - red - off) & 255
        left[1, i] = off & 255
        left[2, i] = (np.int64(colors[i, 2]) - blue - off) & 255


@kernel
def _unpack(keys, left, colors):
    beside, behind = np.int64(0), np.int64(0)
    for i in range(len(keys)):
        red, green, blue, beside, behind = _expected(keys, colors, i, beside, behind)
        off = np.int64(left[1, i])
        colors[i, 0] = (np.int64(left[0, i]) + off + red) & 255
        colors[i, 1] = (off + green) & 255
        colors[i, 2] = (np.int64(left[2, i]) + off + blue) & 255
