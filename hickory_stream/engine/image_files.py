"""Images of kept views as files: what one claims to be is looked at before memory is taken for it.

A file says its kind by its suffix. Of JPEG and WebP only the plain form that OpenCV writes is read: baseline, lossy,
without alpha.
"""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.confined import read_within
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import MOST_SIDE_PX

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# A view is a part of an image of a camera.
_MOST_PIXELS = 1 << 26
# Segments of a JPEG that may come before its frame header: tables, restart interval, comment, APP0 to APP15.
_JPEG_BEFORE_FRAME = {0xC4, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)}
_JPEG_BASELINE = 0xC0


def png_bytes(image: NDArray[Any], *, is_bilevel: bool = False) -> bytes:
    """Return an image as PNG, quickly: (H, W, 4) uint8 BGRA, (H, W) uint16 or uint8; of one bit if `is_bilevel`."""
    import cv2

    # Run lengths only: as small as level 1 on camera images and a third quicker. One filter for all rows, the one that
    # is chosen for nearly all where each may have its own: as small and a fifth quicker.
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    how += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_PAETH]
    if is_bilevel:
        how = [cv2.IMWRITE_PNG_BILEVEL, 1]
    return cv2.imencode(".png", image, how)[1].tobytes()


def lossy_bytes(bgr: NDArray[np.uint8], suffix: str, quality: int) -> bytes:
    """Return an image (H, W, 3) uint8 BGR as `.jpg` or `.webp`; `quality` in percent."""
    import cv2

    how = [cv2.IMWRITE_WEBP_QUALITY, quality]
    if suffix == ".jpg":
        # Colour in full resolution: at the edges of an object that of what lies behind it is not to come in.
        full = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
        how = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, full]
    return cv2.imencode(suffix, bgr, how)[1].tobytes()


def read_image(path: Path, dtype: np.dtype[Any], num_dimensions: int, crc32: int | None = None) -> NDArray[Any]:
    """Return the image of a file as it was stored, (H, W) or (H, W, channels) of BGR or BGRA; `crc32` is the file's.

    Raises:
        MapFolderError: it is missing, damaged, another kind of image, or claims to be larger than any view.
    """
    import cv2

    try:
        data = read_within(path.parent, path.name)
        # Of a damaged file the decoder tells on the terminal, past everybody, or not at all.
        if crc32 is not None and zlib.crc32(data) != crc32:
            raise ValueError("it is not the file that the view's description tells of")
        width, height = _CLAIMED_SIZE[path.suffix](data)
        if not (1 <= width <= MOST_SIDE_PX and 1 <= height <= MOST_SIDE_PX and width * height <= _MOST_PIXELS):
            raise ValueError(f"{width} x {height} pixels, which no view has")
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, ValueError, cv2.error) as error:
        raise MapFolderError(f"cannot read {path}: {error}; play the log again") from error
    if image is None or image.dtype != dtype or image.ndim != num_dimensions:
        raise MapFolderError(f"{path} is no complete image of a view; play the log again")
    return np.asarray(image)


def _png_size(data: bytes) -> tuple[int, int]:
    """Return width and height that a PNG claims; its checksums are looked at, too."""
    if len(data) < 24 or data[:8] != b"\x89PNG\r\n\x1a\n" or data[12:16] != b"IHDR":
        raise ValueError("it is no PNG")
    at, kind = 8, b""
    while kind != b"IEND":
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        end = at + 8 + length
        if end + 4 > len(data) or zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            raise ValueError(f"it is cut off or damaged at byte {at}")
        at = end + 4
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def _jpeg_size(data: bytes) -> tuple[int, int]:
    """Return width and height that a baseline JPEG claims (ITU-T T.81, B.2.2)."""
    at = 2
    while data[:2] == b"\xff\xd8" and at + 9 <= len(data) and data[at] == 0xFF:
        kind, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if kind == _JPEG_BASELINE:
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        if kind not in _JPEG_BEFORE_FRAME or length < 2:
            break
        at += 2 + length
    raise ValueError("it is no baseline JPEG")


def _webp_size(data: bytes) -> tuple[int, int]:
    """Return width and height that a lossy WebP claims (RFC 9649, RFC 6386 9.1)."""
    if len(data) < 30 or data[:4] != b"RIFF" or data[8:16] != b"WEBPVP8 " or data[23:26] != b"\x9d\x01\x2a":
        raise ValueError("it is no plain lossy WebP")
    # The two bits above say how to scale it, which decoders leave to others.
    return int.from_bytes(data[26:28], "little") & 0x3FFF, int.from_bytes(data[28:30], "little") & 0x3FFF


_CLAIMED_SIZE = {".png": _png_size, ".jpg": _jpeg_size, ".webp": _webp_size}
