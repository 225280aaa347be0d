"""RVL: lossless depth in nibbles (Wilson, "Fast Lossless Depth Image Compression", ISS 2017), as ROS transports it.

Runs of zeros alternate with zigzag-coded differences; numbers are nibbles of three bits, lowest first, top bit = more.
Eight nibbles form a little-endian 32-bit word, highest first.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel


def decode_rvl(data: bytes, num_pixels: int) -> NDArray[np.uint16] | None:
    """Return the pixels (num_pixels,), or None if the data hold fewer or more."""
    words = np.frombuffer(data[: len(data) // 4 * 4], dtype="<u4").astype(np.uint32)
    pixels = np.zeros(num_pixels, dtype=np.uint16)
    return pixels if _decode(words, pixels) else None


@kernel
def _number(words, at):
    # The number and the place behind it, -1 if there is none.
    number = 0
    for shift in range(0, 33, 3):
        if at >= 8 * len(words):
            break
        nibble = (words[at // 8] >> np.uint32(28 - 4 * (at % 8))) & np.uint32(15)
        at += 1
        number |= int(nibble & np.uint32(7)) << shift
        if nibble <= 7:
            return number, at
    return 0, -1


@kernel
def _decode(words, pixels):
    at, place, previous = 0, 0, 0
    while place < len(pixels):
        for part in range(2):
            number, at = _number(words, at)
            if at < 0 or number > len(pixels) - place:
                return False
            if part == 0:
                place += number
                continue
            for _ in range(number):
                value, at = _number(words, at)
                if at < 0:
                    return False
                previous += (value >> 1) ^ -(value & 1)
                pixels[place] = previous & 0xFFFF
                place += 1
    return True
