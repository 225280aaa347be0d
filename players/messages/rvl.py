"""RVL: lossless depth in nibbles (Wilson, "Fast Lossless Depth Image Compression", ISS 2017), as ROS transports it.

Runs of zeros alternate with zigzag-coded differences; numbers are nibbles of three bits, lowest first, top bit = more.
Eight nibbles form a little-endian 32-bit word, highest first.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.base.compiled import kernel

if TYPE_CHECKING:
    from numpy.typing import NDArray


def decode_rvl(data: bytes, num_pixels: int) -> NDArray[np.uint16] | None:
    """Return the pixels (num_pixels,), or None if the data hold fewer or more."""
    words = np.frombuffer(data[: len(data) // 4 * 4], dtype="<u4").astype(np.uint32)
    pixels = np.zeros(num_pixels, dtype=np.uint16)
    return pixels if _decode(words, pixels) else None


def encode_rvl(pixels: NDArray[np.uint16]) -> bytes:
    """Return the RVL of pixels in any shape."""
    flat = np.ascontiguousarray(pixels, dtype=np.uint16).ravel()
    nibbles = np.zeros(flat.size * 8 + 64, dtype=np.uint8)
    used = _encode(flat, nibbles)
    padded = nibbles[: -(-used // 8) * 8].reshape(-1, 8).astype(np.uint32)
    words = np.zeros(len(padded), dtype=np.uint32)
    for i in range(8):
        words |= padded[:, i] << np.uint32(28 - 4 * i)
    return words.astype("<u4").tobytes()


@kernel
def _decode(words, pixels):
    at, end = 0, 8 * len(words)
    place, previous = 0, 0
    while place < len(pixels):
        for part in range(2):
            number, shift, more = 0, 0, True
            while more:
                if at >= end or shift > 30:
                    return False
                nibble = (words[at // 8] >> np.uint32(28 - 4 * (at % 8))) & np.uint32(15)
                at += 1
                number |= int(nibble & np.uint32(7)) << shift
                shift += 3
                more = nibble > 7
            if number > len(pixels) - place:
                return False
            if part == 0:
                place += number
                continue
            for _ in range(number):
                value, shift, more = 0, 0, True
                while more:
                    if at >= end or shift > 30:
                        return False
                    nibble = (words[at // 8] >> np.uint32(28 - 4 * (at % 8))) & np.uint32(15)
                    at += 1
                    value |= int(nibble & np.uint32(7)) << shift
                    shift += 3
                    more = nibble > 7
                previous += (value >> 1) ^ -(value & 1)
                pixels[place] = previous & 0xFFFF
                place += 1
    return True


@kernel
def _put(number, nibbles, used):
    while True:
        low = number & 7
        number >>= 3
        nibbles[used] = low | (8 if number else 0)
        used += 1
        if not number:
            return used


@kernel
def _encode(flat, nibbles):
    used, at, previous = 0, 0, 0
    while at < len(flat):
        start = at
        while at < len(flat) and flat[at] == 0:
            at += 1
        used = _put(at - start, nibbles, used)
        start = at
        while at < len(flat) and flat[at] != 0:
            at += 1
        used = _put(at - start, nibbles, used)
        for i in range(start, at):
            delta = int(flat[i]) - previous
            previous = int(flat[i])
            used = _put((delta << 1) ^ (delta >> 31), nibbles, used)
    return used
