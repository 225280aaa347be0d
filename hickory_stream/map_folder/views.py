"""The pixels of a kept view as files: colour with the mask as alpha, depth in millimetres, camera and pose.

Colour may be lossy (`run.view_colors`): the mask is then a file of its own, and the description has the checksum of
the colour's file, since JPEG and WebP lack one. Only JPEG and WebP as OpenCV writes them are read: baseline, lossy,
without alpha. Claimed sizes are checked before memory is taken.

Files are written without a sync (2-3 ms a view); `MapFolder.save` syncs a view before its first reference. The
description comes last, as the mark of a complete view.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.base.atomic_files import disk_errors, write_atomically
from hickory_stream.base.confined import plain_name, read_within
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import MOST_SIDE_PX, Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.ports import Crop

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.config import RunConfig

_MOST_PIXELS = 1 << 26
# Segments of a JPEG that may come before its frame header: tables, restart interval, comment, APP0 to APP15.
_JPEG_BEFORE_FRAME = {0xC4, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)}
_JPEG_BASELINE = 0xC0


def png_bytes(image: NDArray[Any], *, is_bilevel: bool = False) -> bytes:
    """Return a PNG, quickly, of (H, W, 4) uint8 BGRA, (H, W) uint16 or uint8; of one bit if `is_bilevel`."""
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
        # Colour in full resolution: at an object's edges, none of the background comes in.
        full = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
        how = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, full]
    return cv2.imencode(suffix, bgr, how)[1].tobytes()


def read_image(path: Path, dtype: np.dtype[Any], num_dimensions: int, crc32: int | None = None) -> NDArray[Any]:
    """Return the stored image, (H, W) or (H, W, channels) of BGR or BGRA; `crc32` is the file's.

    Raises `MapFolderError`: it is missing, damaged, another kind of image, or claims more than the size of any view.
    """
    import cv2

    try:
        data = read_within(path.parent, path.name)
        # The decoder writes of a damaged file to the terminal, or nothing at all.
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
    # Checks the checksums, too.
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
    # Baseline JPEG: ITU-T T.81, B.2.2.
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
    # Lossy WebP: RFC 9649, RFC 6386 9.1.
    if len(data) < 30 or data[:4] != b"RIFF" or data[8:16] != b"WEBPVP8 " or data[23:26] != b"\x9d\x01\x2a":
        raise ValueError("it is no plain lossy WebP")
    # The two bits above say how to scale it, which decoders leave to others.
    return int.from_bytes(data[26:28], "little") & 0x3FFF, int.from_bytes(data[28:30], "little") & 0x3FFF


_CLAIMED_SIZE = {".png": _png_size, ".jpg": _jpeg_size, ".webp": _webp_size}


_MAX_MM = 65535
_LOSSY = {"jpeg": ".jpg", "webp": ".webp"}
# WebP has 14 bits for a side; a longer one is written as PNG.
_MOST_LOSSY_SIDE_PX = 16383


def crop_files(views: Path, name: str) -> tuple[Path, ...]:
    """Return the paths of a view's colour, depth, mask (if colour is lossy) and description in the folder `views`."""
    plain_name(name)
    depth, mask, description = views / f"{name}.depth.png", views / f"{name}.mask.png", views / f"{name}.json"
    for suffix in _LOSSY.values():
        color = views / f"{name}.color{suffix}"
        if color.exists():
            return color, depth, mask, description
    return views / f"{name}.color.png", depth, description


def write_crop(views: Path, name: str, crop: Crop, how: RunConfig | None = None) -> None:
    """Write a view's pixels into the folder `views` under `name` (`View.name`); colour as `how.view_colors`, or exact.

    Depth is rounded to millimetres; more than 65.5 m becomes "no return". Raises `MapFolderError`: the disk refused.
    """
    description: dict[str, Any] = {
        "camera": asdict(crop.camera),
        "world_from_camera": crop.world_from_camera.tolist(),
        "sensor": asdict(crop.sensor),
    }
    bgr, mask = crop.rgb[..., ::-1], crop.mask.astype(np.uint8) * np.uint8(255)
    files = {"depth.png": png_bytes(_millimetres(crop.depth_m))}
    if how is not None and how.view_colors in _LOSSY and max(mask.shape) <= _MOST_LOSSY_SIDE_PX:
        suffix = _LOSSY[how.view_colors]
        color = lossy_bytes(np.ascontiguousarray(bgr), suffix, how.view_quality)
        files |= {"mask.png": png_bytes(mask, is_bilevel=True), f"color{suffix}": color}
        description["color_crc32"] = zlib.crc32(color)
    else:
        with_mask = np.empty((*mask.shape, 4), dtype=np.uint8)
        with_mask[..., :3], with_mask[..., 3] = bgr, mask
        files["color.png"] = png_bytes(with_mask)
    with disk_errors(views):
        for ending, data in files.items():
            write_atomically(views / f"{name}.{ending}", data, sync=False)
        write_atomically(views / f"{name}.json", dumps_exactly(description).encode(), sync=False)


def read_crop(views: Path, name: str) -> Crop:
    """Return the pixels of a view, depth to the millimetre. Raises `MapFolderError`: a file is missing or damaged."""
    color_file, depth_file, *mask_file, description_file = crop_files(views, name)
    try:
        description = json.loads(read_within(views, description_file.name))
        crc32 = int(description["color_crc32"]) if mask_file else None
        color = read_image(color_file, np.dtype(np.uint8), 3, crc32)
        depth = read_image(depth_file, np.dtype(np.uint16), 2)
        mask = read_image(mask_file[0], np.dtype(np.uint8), 2) if mask_file else color[..., 3]
        return Crop(
            rgb=color[..., 2::-1],
            depth_m=np.where(depth == 0, np.float32(np.nan), depth.astype(np.float32) / np.float32(1000)),
            mask=mask > 127,
            camera=Camera(**description["camera"]),
            world_from_camera=description["world_from_camera"],
            sensor=DepthSensor(**description["sensor"]),
        )
    except (OSError, KeyError, TypeError, ValueError, IndexError, RecursionError) as error:
        raise MapFolderError(f"view {name} in {views} is damaged: {error}; play the log again") from error


def read_mask(views: Path, name: str) -> NDArray[np.bool_]:
    """Return the mask of a view alone. Raises `MapFolderError`: its file is missing or damaged."""
    color_file, _, *mask_file, _ = crop_files(views, name)
    try:
        if mask_file:
            return np.asarray(read_image(mask_file[0], np.dtype(np.uint8), 2) > 127)
        return np.asarray(read_image(color_file, np.dtype(np.uint8), 3)[..., 3] > 127)
    except (OSError, ValueError, IndexError) as error:
        raise MapFolderError(f"view {name} in {views} is damaged: {error}; play the log again") from error


def _millimetres(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    # 0 = no return.
    with np.errstate(invalid="ignore", over="ignore"):
        millimetres = np.rint(depth_m * np.float32(1000))
        return np.where((millimetres > 0) & (millimetres <= _MAX_MM), millimetres, 0).astype(np.uint16)
