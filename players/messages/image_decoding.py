"""Decoding of images: colour (H, W, 3) uint8 RGB, depth (H, W) float32 metres with NaN.

Truncated images are refused, since decoders fill missing rows with grey or uninitialised memory.
"""

import struct
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.errors import RecordingError
from hickory_stream.geometry.arrays import read_only

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8\xff"
_NO_RETURN_U16 = 65535
MAX_PIXELS = 64_000_000
"""The maximum number of pixels: an image that claims more is damaged, or a decompression bomb."""

_RAW_TYPES = {
    **dict.fromkeys(("rgb8", "bgr8", "8UC3"), ("u1", 3)),
    **dict.fromkeys(("rgba8", "bgra8", "8UC4"), ("u1", 4)),
    **dict.fromkeys(("mono8", "8UC1"), ("u1", 1)),
    **dict.fromkeys(("mono16", "16UC1"), ("u2", 1)),
    "32FC1": ("f4", 1),
    **dict.fromkeys(("yuv422", "uyvy", "UYVY", "yuv422_yuy2", "yuyv", "YUYV"), ("u1", 2)),
    **dict.fromkeys(("nv12", "nv21"), ("u1", 1)),
    **dict.fromkeys(("bayer_rggb8", "bayer_bggr8", "bayer_gbrg8", "bayer_grbg8"), ("u1", 1)),
    **dict.fromkeys(("bayer_rggb16", "bayer_bggr16", "bayer_gbrg16", "bayer_grbg16"), ("u2", 1)),
}
# OpenCV names a Bayer pattern by the second and third pixel of the second row: ROS's rggb is its BG.
_CONVERSIONS = {
    **dict.fromkeys(("yuv422", "uyvy", "UYVY"), cv2.COLOR_YUV2RGB_UYVY),
    **dict.fromkeys(("yuv422_yuy2", "yuyv", "YUYV"), cv2.COLOR_YUV2RGB_YUYV),
    "nv12": cv2.COLOR_YUV2RGB_NV12,
    "nv21": cv2.COLOR_YUV2RGB_NV21,
    "bayer_rggb": cv2.COLOR_BayerBG2RGB,
    "bayer_bggr": cv2.COLOR_BayerRG2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGR2RGB,
    "bayer_grbg": cv2.COLOR_BayerGB2RGB,
}
COLOR_ENCODINGS = tuple(name for name in _RAW_TYPES if name not in ("16UC1", "32FC1"))
DEPTH_ENCODINGS = ("16UC1", "mono16", "32FC1")


def compressed_size(data: bytes) -> tuple[int, int] | None:
    """Return (width, height) from the header of a JPEG or PNG, without decoding; None if there is no header."""
    if data[:8] == PNG and len(data) >= 24:
        return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")
    if data[:3] != JPEG:
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

    Raises `RecordingError`: there is no PNG at either place.
    """
    for start in (12, 0):
        if data[start : start + 8] == PNG:
            return data[start:]
    raise RecordingError(f"{what} holds no PNG ({len(data)} bytes); compressed depth must be a PNG of 16 bits")


def decode_color(data: bytes, what: str) -> NDArray[np.uint8]:
    """Return a JPEG or PNG as (H, W, 3) uint8 RGB; `what` names the image in errors.

    Raises `RecordingError`: the image is empty, torn or neither JPEG nor PNG.
    """
    _check_whole(data, what)
    buffer = np.frombuffer(data, dtype=np.uint8)
    image = cv2.imdecode(buffer, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    if image is None:
        raise RecordingError(f"{what} cannot be decoded ({len(data)} bytes)")
    return np.asarray(image, dtype=np.uint8)


def decode_depth_png(data: bytes, units_per_m: float, what: str) -> NDArray[np.float32]:
    """Return a 16-bit PNG as (H, W) float32 metres; 0 and 65535 are no return.

    Raises `RecordingError`: the image is empty, torn or not a PNG of one 16-bit channel.
    """
    return metres_of_u16(_decode_u16_png(data, what), units_per_m)


def _decode_u16_png(data: bytes, what: str) -> NDArray[np.uint16]:
    _check_whole(data, what)
    image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise RecordingError(f"{what} cannot be decoded ({len(data)} bytes)")
    if image.dtype != np.uint16 or image.ndim != 2:
        found = f"{image.dtype} with {1 if image.ndim == 2 else image.shape[2]} channels"
        raise RecordingError(f"{what} is {found}; depth must be 16 bits in one channel")
    return np.asarray(image, dtype=np.uint16)


def decode_compressed_depth(data: bytes, encoding: str, units_per_m: float, what: str) -> NDArray[np.float32]:
    """Return the depth (H, W) float32 metres of a CompressedImage; its format string is not relied on.

    Accepted are 16-bit PNG, with or without the 12-byte header of `compressedDepth` (int32 kind, float32 A, float32 B),
    and RVL with that header. If `encoding` begins with 32FC1, the numbers are inverse depth: A / (number - B) metres.

    Raises `RecordingError`: it is empty, torn, of another kind, or inverse depth without its parameters.
    """
    if not data:
        raise RecordingError(f"{what} is empty")
    numbers = _depth_numbers(data, what)
    if not encoding.strip().startswith("32FC1"):
        return metres_of_u16(numbers, units_per_m)
    kind, a, b = struct.unpack_from("<iff", data, 0)
    if data[:8] == PNG or kind != 0 or not (np.isfinite((a, b)).all() and a > 0):
        raise RecordingError(f"{what} is inverse depth without parameters (kind {kind}, A {a:g}, B {b:g})")
    with np.errstate(divide="ignore"):
        depth_m = np.float32(a) / (numbers.astype(np.float32) - np.float32(b))
    depth_m[(numbers == 0) | ~np.isfinite(depth_m) | (depth_m <= 0)] = np.nan
    return np.asarray(depth_m, dtype=np.float32)


def _depth_numbers(data: bytes, what: str) -> NDArray[np.uint16]:
    if data[:8] == PNG or data[12:20] == PNG:
        return _decode_u16_png(png_part(data, what), what)
    width, height = rvl_size(data)
    if 0 < width * height <= MAX_PIXELS and width * height <= 64 * len(data) * 64:
        from players.messages.rvl import decode_rvl

        pixels = decode_rvl(data[20:], width * height)
        if pixels is not None:
            return pixels.reshape(height, width)
    raise RecordingError(f"{what} holds neither a PNG of 16 bits nor RVL ({len(data)} bytes)")


def rvl_size(data: bytes) -> tuple[int, int]:
    """Return (width, height) of RVL data behind the `compressedDepth` header; (0, 0) if too short or implausible."""
    if len(data) < 24:
        return 0, 0
    width, height = struct.unpack_from("<ii", data, 12)
    return (width, height) if 0 < width < 1 << 16 and 0 < height < 1 << 16 else (0, 0)


def metres_of_u16(raw: NDArray[np.uint16], units_per_m: float) -> NDArray[np.float32]:
    """Return integer depth as float32 metres; 0 and 65535 are no return and become NaN."""
    depth_m: NDArray[np.float32] = _metres(raw, np.float32(1.0 / units_per_m))
    return depth_m


@kernel
def _metres(raw, scale):
    out = np.empty(raw.shape, dtype=np.float32)
    for y in range(raw.shape[0]):
        for x in range(raw.shape[1]):
            value = raw[y, x]
            is_return = value != 0 and value != _NO_RETURN_U16
            out[y, x] = np.float32(value) * scale if is_return else np.float32(np.nan)
    return out


def raw_pixels(message: Any, what: str) -> NDArray[Any]:
    """Return the pixels of a `sensor_msgs/Image` as (H, W) or (H, W, C) in native byte order, for any step.

    Raises `RecordingError`: fewer bytes than the header announces.
    """
    dtype, channels = _RAW_TYPES[message.encoding]
    wire = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    row_bytes = message.width * channels * wire.itemsize
    # NV12 and NV21: the chroma plane follows the luma plane, with half as many rows.
    height = message.height * 3 // 2 if message.encoding in ("nv12", "nv21") else message.height
    step = max(int(message.step), row_bytes)
    data = np.asarray(message.data, dtype=np.uint8)
    # The padding of the last row may be missing.
    if row_bytes == 0 or height == 0 or data.size < step * (height - 1) + row_bytes:
        expected = f"{message.width}x{message.height} {message.encoding} with {step} bytes a row"
        raise RecordingError(f"{what} holds {data.size} bytes; expected {expected}")
    rows = np.lib.stride_tricks.as_strided(data, (height, row_bytes), (step, 1), writeable=False)
    pixels = np.ascontiguousarray(rows).view(wire).astype(np.dtype(dtype), copy=False)
    return pixels if channels == 1 else pixels.reshape(height, message.width, channels)


def color_of_pixels(pixels: NDArray[Any], encoding: str) -> NDArray[np.uint8]:
    """Return raw pixels of one of `COLOR_ENCODINGS` as (H, W, 3) uint8 RGB, without alpha, the top 8 of 16 bits."""
    conversion = _CONVERSIONS.get(encoding.removesuffix("16").removesuffix("8"))
    if conversion is not None:
        if pixels.dtype == np.uint16:
            pixels = (pixels >> 8).astype(np.uint8)
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), conversion), dtype=np.uint8)
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
    depth_m: NDArray[np.float32] = _returns(read_only(pixels).ravel()).reshape(pixels.shape)
    return depth_m


@kernel
def _returns(metres):
    out = np.empty(len(metres), np.float32)
    for i in range(len(metres)):
        out[i] = metres[i] if (metres[i] > 0) & (metres[i] < np.inf) else np.nan
    return out


def _check_whole(data: bytes, what: str) -> None:
    # Some cameras pad with zeros behind the end marker.
    if not data:
        raise RecordingError(f"{what} is empty")
    tail = data[-4096:].rstrip(b"\0")[-16:]
    if data[:8] == PNG:
        is_whole = b"IEND" in tail
    elif data[:3] == JPEG:
        is_whole = tail.endswith(b"\xff\xd9")
    else:
        raise RecordingError(f"{what} is neither JPEG nor PNG (it begins with {data[:8].hex(' ')})")
    if not is_whole:
        raise RecordingError(f"{what} is torn: its end is missing ({len(data)} bytes)")
    size = compressed_size(data)
    if size is not None and size[0] * size[1] > MAX_PIXELS:
        raise RecordingError(f"{what} claims {size[0]}x{size[1]} pixels, over the limit of {MAX_PIXELS}")
