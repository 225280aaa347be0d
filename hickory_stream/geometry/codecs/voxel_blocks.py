"""Sorted voxel keys as blocks of bits: 64 cells above one another are one word, with a bit for each.

Long columns of free space take less than a byte a voxel so. Voxels that lie apart take more than keys: `is_denser`.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel

MOST_KEYS = 1 << 24
"""More than a submap has; a few bytes of forged blocks could claim all of the memory."""

_BITS = 6
_LOW = (1 << _BITS) - 1


def blocks_of(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
    """Return the ascending heads (M,) and the words (M,) of the blocks that strictly ascending keys (N,) lie in."""
    heads, words = np.empty(len(keys), dtype=np.int64), np.empty(len(keys), dtype=np.uint64)
    count = _put_blocks(keys, heads, words)
    return heads[:count], words[:count]


def keys_of_blocks(heads: NDArray[np.int64], words: NDArray[np.uint64]) -> NDArray[np.int64]:
    """Return the keys (N,) of blocks, ascending where the heads are."""
    bits = np.unpackbits(words.astype("<u8").view(np.uint8), bitorder="little")
    at = np.flatnonzero(bits)
    return (heads[at >> _BITS] << _BITS) | (at & _LOW)


def count_in(words: NDArray[np.uint64]) -> int:
    """Return how many voxels the words of blocks hold, without making them."""
    return int(np.bitwise_count(words).sum(dtype=np.int64))


def is_denser(keys: NDArray[np.int64]) -> bool:
    """Return whether keys (N,) ascend strictly, and take less as blocks than as they are, at two numbers a block."""
    if not 0 < len(keys) <= MOST_KEYS:
        return False
    count = _num_blocks(keys)
    return bool(0 < 2 * count <= len(keys))


@kernel
def _num_blocks(keys):
    # 0 where the keys do not ascend strictly.
    count = 1
    for i in range(1, len(keys)):
        if keys[i] <= keys[i - 1]:
            return 0
        count += keys[i] >> _BITS != keys[i - 1] >> _BITS
    return count


@kernel
def _put_blocks(keys, heads, words):
    count = 0
    for i in range(len(keys)):
        head = keys[i] >> _BITS
        if count == 0 or heads[count - 1] != head:
            heads[count], words[count] = head, np.uint64(0)
            count += 1
        words[count - 1] |= np.uint64(1) << np.uint64(keys[i] & _LOW)
    return count
