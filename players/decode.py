"""Images as logs hold them, into arrays: colour (H, W, 3) uint8 RGB, depth (H, W) float32 metres with NaN.

A torn image is refused rather than shown: decoders fill the missing rows with grey, or with whatever lies there.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from hickory_stream.errors import RecordingError

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8\xff"
_NO_RETURN_U16 = 65535

_RAW_TYPES = {
    "rgb8": ("u1", 3),
    "bgr8": ("u1", 3),
    "8UC3": ("u1", 3),
    "rgba8": ("u1", 4),
    "bgra8": ("u1", 4),
    "8UC4": ("u1", 4),
    "mono8": ("u1", 1),
    "8UC1": ("u1", 1),
    "mono16": ("u2", 1),
    "16UC1": ("u2", 1),
    "32FC1": ("f4", 1),
}
COLOR_ENCODINGS = ("rgb8", "bgr8", "8UC3", "rgba8", "bgra8", "8UC4", "mono8", "8UC1", "mono16")
DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")


def compressed_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) as the header of a JPEG or PNG says, without decoding; None where there is no header."""
    if data[:8] == _PNG and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data[:3] != _JPEG:
        return None
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        # The frame header, SOF0 to SOF15, without the tables DHT, JPG and DAC that share its range.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            return int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        at += 1 if marker == 0xFF else 2 + length
    return None


def png_part(data: bytes, what: str) -> bytes:
    """Return the PNG of a depth message: behind the 12-byte header of `compressedDepth`, or bare.

    Raises:
        RecordingError: there is no PNG at either place.
    """
    for start in (12, 0):
        if data[start : start + 8] == _PNG:
            return data[start:]
    raise RecordingError(f"{what} holds no PNG ({len(data)} bytes); compressed depth must be a PNG of 16 bits")


def decode_color(data: bytes, what: str) -> NDArray[np.uint8]:
    """Return a JPEG or PNG as (H, W, 3) uint8 RGB; `what` names the image in errors.

    Raises:
        RecordingError: the image is empty, torn or neither JPEG nor PNG.
    """
    _check_whole(data, what)
    buffer = np.frombuffer(data, dtype=np.uint8)
    image = cv2.imdecode(buffer, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise RecordingError(f"{what} cannot be decoded ({len(data)} bytes)")
    return np.asarray(image, dtype=np.uint8)


def decode_depth_png(data: bytes, units_per_m: float, what: str) -> NDArray[np.float32]:
    """Return a 16-bit PNG as (H, W) float32 metres; 0 and 65535 are no return.

    Raises:
        RecordingError: the image is empty, torn or not a PNG of one 16-bit channel.
    """
    _check_whole(data, what)
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise RecordingError(f"{what} cannot be decoded ({len(data)} bytes)")
    if image.dtype != np.uint16 or image.ndim != 2:
        found = f"{image.dtype} with {1 if image.ndim == 2 else image.shape[2]} channels"
        raise RecordingError(f"{what} is {found}; depth must be 16 bits in one channel")
    return metres_of_u16(np.asarray(image, dtype=np.uint16), units_per_m)


def metres_of_u16(raw: NDArray[np.uint16], units_per_m: float) -> NDArray[np.float32]:
    """Return integer depth as float32 metres; 0 and 65535 are no return and become NaN."""
    depth_m = raw.astype(np.float32) * np.float32(1.0 / units_per_m)
    depth_m[(raw == 0) | (raw == _NO_RETURN_U16)] = np.nan
    return depth_m


def raw_pixels(message: Any, what: str) -> NDArray[Any]:
    """Return the pixels of a `sensor_msgs/Image` as (H, W) or (H, W, C) in native byte order, for any step.

    Raises:
        RecordingError: fewer bytes than the header announces.
    """
    dtype, channels = _RAW_TYPES[message.encoding]
    big = bool(message.is_bigendian)
    wire = np.dtype(dtype).newbyteorder(">" if big else "<")
    row_bytes = message.width * channels * wire.itemsize
    step = max(int(message.step), row_bytes)
    data = np.asarray(message.data, dtype=np.uint8)
    # The padding of the last row may be missing.
    if row_bytes == 0 or message.height == 0 or data.size < step * (message.height - 1) + row_bytes:
        expected = f"{message.width}x{message.height} {message.encoding} with {step} bytes a row"
        raise RecordingError(f"{what} holds {data.size} bytes; expected {expected}")
    rows = np.lib.stride_tricks.as_strided(data, (message.height, row_bytes), (step, 1), writeable=False)
    pixels = np.ascontiguousarray(rows).view(wire).astype(np.dtype(dtype), copy=False)
    return pixels if channels == 1 else pixels.reshape(message.height, message.width, channels)


def color_of_pixels(pixels: NDArray[Any], encoding: str) -> NDArray[np.uint8]:
    """Return raw pixels of one of `COLOR_ENCODINGS` as (H, W, 3) uint8 RGB, without alpha, of 16 bits the top 8."""
    if encoding == "mono16":
        pixels = (pixels >> 8).astype(np.uint8)
    if pixels.ndim == 2:
        return np.repeat(pixels[..., None], 3, axis=2)
    rgb = pixels[..., :3] if encoding.startswith("rgb") else pixels[..., 2::-1]
    return np.ascontiguousarray(rgb)


def depth_of_pixels(pixels: NDArray[Any], units_per_m: float = 1000.0) -> NDArray[np.float32]:
    """Return raw pixels of one of `DEPTH_ENCODINGS` as float32 metres: integers are millimetres (REP 118)."""
    if pixels.dtype == np.uint16:
        return metres_of_u16(pixels, units_per_m)
    return np.where(np.isfinite(pixels) & (pixels > 0), pixels, np.float32(np.nan)).astype(np.float32)


def _check_whole(data: bytes, what: str) -> None:
    """Refuse an image without its end marker; some cameras pad with zeros behind it."""
    if not data:
        raise RecordingError(f"{what} is empty")
    tail = data[-4096:].rstrip(b"\0")[-16:]
    if data[:8] == _PNG:
        is_whole = b"IEND" in tail
    elif data[:3] == _JPEG:
        is_whole = tail.endswith(b"\xff\xd9")
    else:
        raise RecordingError(f"{what} is neither JPEG nor PNG (it begins with {data[:8].hex(' ')})")
    if not is_whole:
        raise RecordingError(f"{what} is torn: its end is missing ({len(data)} bytes)")
