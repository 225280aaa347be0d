"""The pixels of a kept view: colour, depth in millimetres, mask, camera and pose, packed like points in one file.

Colour may be lossy (`run.view_colors`). Only JPEG and WebP as OpenCV writes them are read: baseline, lossy, without
alpha. Claimed sizes are checked before memory is taken.

Files are written without a sync (2-3 ms a view); `MapFolder.save` syncs a view before its first reference. Maps of
format 3 have images and a description instead, which are only read.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.base.atomic_files import disk_errors, write_atomically
from hickory_stream.base.confined import plain_name, read_within
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import MOST_SIDE_PX, Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.map_folder.array_files import packed, unpacked
from hickory_stream.ports import Crop

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.config import RunConfig

_MOST_PIXELS = 1 << 26
# Segments of a JPEG that may come before its frame header: tables, restart interval, comment, APP0 to APP15.
_JPEG_BEFORE_FRAME = {0xC4, 0xDB, 0xDD, 0xFE, *range(0xE0, 0xF0)}
_JPEG_BASELINE = 0xC0


def lossy_bytes(bgr: NDArray[np.uint8], suffix: str, quality: int) -> bytes:
    """Return an image (H, W, 3) uint8 BGR as `.jpg` or `.webp`; `quality` in percent."""
    import cv2

    how = [cv2.IMWRITE_WEBP_QUALITY, quality]
    if suffix == ".jpg":
        # Colour in full resolution: at an object's edges, none of the background comes in.
        full = cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
        how = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, full]
    return cv2.imencode(suffix, bgr, how)[1].tobytes()


def _image(data: bytes, suffix: str) -> NDArray[Any]:
    # (H, W) or (H, W, channels), RGB or RGBA. Raises ValueError or cv2.error.
    import cv2

    width, height = _CLAIMED_SIZE[suffix](data)
    if not (1 <= width <= MOST_SIDE_PX and 1 <= height <= MOST_SIDE_PX and width * height <= _MOST_PIXELS):
        raise ValueError(f"{width} x {height} pixels, which no view has")
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ValueError("no complete image")
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
# WebP has 14 bits for a side; a longer one is written without loss.
_MOST_LOSSY_SIDE_PX = 16383


def crop_files(views: Path, name: str) -> tuple[Path, ...]:
    """Return the path of a view in the folder `views`.

    In a map of format 3: of its colour, depth, mask (if colour is lossy) and description.
    """
    plain_name(name)
    description = views / f"{name}.json"
    if not description.exists():
        return (views / f"{name}.view",)
    files = [views / f"{name}.color.png", views / f"{name}.depth.png", description]
    for color in (views / f"{name}.color{suffix}" for suffix in _LOSSY.values()):
        if color.exists():
            files = [color, files[1], views / f"{name}.mask.png", description]
    return tuple(files)


def write_crop(views: Path, name: str, crop: Crop, how: RunConfig | None = None) -> None:
    """Write a view's pixels into the folder `views` under `name` (`View.name`); colour as `how.view_colors`, or exact.

    Depth is rounded to millimetres; more than 65.5 m becomes "no return". Raises `MapFolderError`: the disk refused.
    """
    view: dict[str, Any] = {
        "camera": asdict(crop.camera),
        "world_from_camera": crop.world_from_camera,
        "sensor": asdict(crop.sensor),
        "depth_mm": _millimetres(crop.depth_m),
        "mask": crop.mask,
    }
    if how is not None and how.view_colors in _LOSSY and max(crop.mask.shape) <= _MOST_LOSSY_SIDE_PX:
        suffix = _LOSSY[how.view_colors]
        view[suffix] = lossy_bytes(np.ascontiguousarray(crop.rgb[..., ::-1]), suffix, how.view_quality)
    else:
        view["rgb"] = crop.rgb.reshape(-1, 3)
    with disk_errors(views):
        write_atomically(views / f"{name}.view", packed(view), sync=False)


def read_crop(views: Path, name: str) -> Crop:
    """Return the pixels of a view, depth to the millimetre. Raises `MapFolderError`: it is missing or damaged."""
    import cv2

    files = crop_files(views, name)
    try:
        view = _read(views, *files)
        depth = view["depth_mm"]
        return Crop(
            rgb=view["rgb"].reshape(*depth.shape, 3),
            depth_m=np.where(depth == 0, np.float32(np.nan), depth.astype(np.float32) / np.float32(1000)),
            mask=view["mask"],
            camera=Camera(**view["camera"]),
            world_from_camera=view["world_from_camera"],
            sensor=DepthSensor(**view["sensor"]),
        )
    except (OSError, KeyError, TypeError, ValueError, AttributeError, IndexError, RecursionError, cv2.error) as error:
        raise MapFolderError(f"cannot read {files[0]}: {error}; play the log again") from error


def _read(views: Path, *files: Path) -> dict[str, Any]:
    view: dict[str, Any]
    if len(files) == 1:
        view = unpacked(read_within(views, files[0].name))
        lossy = [_image(view[suffix], suffix)[..., ::-1] for suffix in _LOSSY.values() if suffix in view]
        return view if not lossy else {**view, "rgb": lossy[0]}
    color, depth, *mask, description = (read_within(views, file.name) for file in files)
    view = json.loads(description)
    # The decoder writes of a damaged file to the terminal, or nothing at all.
    if mask and zlib.crc32(color) != view["color_crc32"]:
        raise ValueError("it is not the file that the view's description tells of")
    pixels = _image(color, files[0].suffix)
    inside = _image(mask[0], ".png") if mask else pixels[..., 3]
    return {**view, "rgb": pixels[..., 2::-1], "depth_mm": _image(depth, ".png"), "mask": inside > 127}


def _millimetres(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    # 0 = no return.
    with np.errstate(invalid="ignore", over="ignore"):
        millimetres = np.rint(depth_m * np.float32(1000))
        return np.where((millimetres > 0) & (millimetres <= _MAX_MM), millimetres, 0).astype(np.uint16)
