"""Colours that are means of a few whole ones as bytes that compress: of how many each is the mean, and of what sum.

A mean in float32 looks like noise in its lower bytes. As a sum of whole numbers over their number it takes a third
less, and the last bits, in which the order of adding shows, are told beside it: it comes back to the bit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry.packing import color_planes, colors_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MOST_HITS, _MOST_OFF = 255, 7
# A row that is no such mean is stored as it is; where most of these are none, the array is no array of means.
_ROW_BYTES, _MEAN_BYTES, _SAMPLED = 12, 10, 64


def packed_means(colors: NDArray[np.float32]) -> bytes | None:
    """Return the bytes of (N, 3) mean colours; None where most are no means of at most 255 whole ones."""
    for rows in (colors[:: max(1, len(colors) // _SAMPLED)], colors):
        hits, sums = np.zeros(len(rows), dtype=np.uint8), np.zeros((len(rows), 3), dtype=np.int32)
        off = np.zeros((3, len(rows)), dtype=np.uint8)
        # By their bits, so that what is no number is none.
        _split(np.ascontiguousarray(rows), rows.view(np.int32), hits, sums, off)
        if 2 * np.count_nonzero(hits) < len(rows):
            return None
    counts = np.maximum(hits, 1)[:, None].astype(np.int32)
    whole, rest = np.divmod(sums, counts)
    parts = (hits, np.ascontiguousarray(rest.T.astype(np.uint8)), off)
    kept = np.ascontiguousarray(colors[hits == 0], dtype="<f4")
    return b"".join((color_planes(whole.astype(np.uint8)), *(part.tobytes() for part in parts), kept.tobytes()))


def unpacked_means(data: bytes, count: int) -> NDArray[np.float32]:
    """Return the (N, 3) colours of `packed_means`; raises ValueError where there are not as many."""
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


@numba.njit(cache=True, nogil=True)
def _split(colors, bits, hits, sums, off):  # type: ignore[no-untyped-def] # pragma: no cover
    """Put into `hits` the number of colours that each is a mean of, 0: of none; the sums; and how far off the bits are.

    What fits the one before, its neighbour, is tried first.
    """
    one, as_bits = np.empty(1, dtype=np.float32), np.empty(1, dtype=np.int32)
    last = 1
    for i in range(len(colors)):
        for attempt in range(_MOST_HITS + 1):
            count = last if attempt == 0 else attempt
            fits = True
            for k in range(3):
                color = np.float64(colors[i, k])
                if not 0 <= color < 256:
                    fits = False
                    break
                total = np.int64(np.rint(color * count))
                one[0] = total / count
                as_bits[:] = one.view(np.int32)
                difference = np.int64(bits[i, k]) - np.int64(as_bits[0])
                if not -_MOST_OFF <= difference <= _MOST_OFF or total >= 256 * count:
                    fits = False
                    break
                sums[i, k] = total
                off[k, i] = 2 * difference if difference >= 0 else -2 * difference - 1
            if fits:
                hits[i] = last = count
                break
            if not 0 <= colors[i, 0] < 256:
                break
        if hits[i] == 0:
            for k in range(3):
                sums[i, k], off[k, i] = 0, 0
