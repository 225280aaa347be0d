"""Depth images in whole millimetres as bytes that compress: each return as its difference to a prediction.

The prediction is the median of left, upper and plane through both and the one between them (LOCO-I, Weinberger et al.
2000): most returns take a byte. The places of returns are not in these bytes.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel

# Stands for a number that takes two bytes, which follow after all others.
_LONG = 255


def packed_depths(images: Sequence[NDArray[np.uint16]]) -> bytes:
    """Return the bytes of the returns of depth images (h, w), 0 = none, one image after another."""
    count = sum(int(np.count_nonzero(image)) for image in images)
    short, long = np.empty(count, dtype=np.uint8), np.empty(count, dtype=np.uint16)
    at, num_long, last = 0, 0, 0
    for image in images:
        at, num_long, last = _pack(np.array(image, order="C"), short, long, at, num_long, last)
    return short.tobytes() + long[:num_long].astype("<u2").tobytes()


def unpacked_depths(data: bytes, are_there: Sequence[NDArray[np.bool_]]) -> list[NDArray[np.uint16]]:
    """Return the images of `packed_depths`, which have returns where `are_there` (h, w).

    Raises:
        ValueError: there are more or fewer bytes than these returns take, or a return of no depth.
    """
    count = sum(int(np.count_nonzero(is_there)) for is_there in are_there)
    if len(data) < count or (len(data) - count) % 2:
        raise ValueError(f"{count} returns in {len(data)} bytes")
    short, long = np.frombuffer(data[:count], np.uint8), np.frombuffer(data[count:], "<u2").astype(np.uint16)
    if np.count_nonzero(short == _LONG) != len(long):
        raise ValueError(f"{count} returns in {len(data)} bytes")
    images = [np.zeros(is_there.shape, dtype=np.uint16) for is_there in are_there]
    at, num_long, last = 0, 0, 0
    for image, is_there in zip(images, are_there, strict=True):
        at, num_long, last = _unpack(image, is_there, short, long, at, num_long, last)
        if at < 0:
            raise ValueError("a return of no depth")
    return images


@kernel
def _expected(image, y, x, last):
    left = np.int64(image[y, x - 1]) if x > 0 else np.int64(0)
    above = np.int64(image[y - 1, x]) if y > 0 else np.int64(0)
    corner = np.int64(image[y - 1, x - 1]) if x > 0 and y > 0 else np.int64(0)
    if left and above:
        if not corner:
            return (left + above) >> 1
        if corner >= max(left, above):
            return min(left, above)
        if corner <= min(left, above):
            return max(left, above)
        return left + above - corner
    if left:
        return left
    return above if above else last


@kernel
def _pack(image, short, long, at, num_long, last):
    height, width = image.shape
    for y in range(height):
        for x in range(width):
            depth = np.int64(image[y, x])
            if depth == 0:
                continue
            off = (depth - _expected(image, y, x, last) + 32768) % 65536 - 32768
            # 0, -1, 1, -2, ... as 0, 1, 2, 3, ...
            code = 2 * off if off >= 0 else -2 * off - 1
            if code < _LONG:
                short[at] = code
            else:
                short[at] = _LONG
                long[num_long] = code
                num_long += 1
            at += 1
            last = depth
    return at, num_long, last


@kernel
def _unpack(image, is_there, short, long, at, num_long, last):
    height, width = image.shape
    for y in range(height):
        for x in range(width):
            if not is_there[y, x]:
                continue
            code = np.int64(short[at])
            if code == _LONG:
                code = np.int64(long[num_long])
                num_long += 1
            at += 1
            off = code >> 1 if code % 2 == 0 else -((code + 1) >> 1)
            last = (_expected(image, y, x, last) + off) % 65536
            if last == 0:
                return -1, num_long, last
            image[y, x] = last
    return at, num_long, last
