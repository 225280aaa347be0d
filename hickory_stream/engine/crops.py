"""The pixels of a kept view as three files: colour with the mask as alpha, depth in millimetres, camera and pose.

They are written without a sync (2-3 ms a view); `MapFolder.save` syncs a view before the map first refers to it. The
description comes last, so that a view which has one is complete.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.confined import plain_name, read_within
from hickory_stream.engine.atomic import disk_errors, write_atomically
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import MOST_SIDE_PX, Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.json_text import dumps_exactly
from hickory_stream.ports import Crop

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

_MAX_MM = 65535
# A view is a part of an image of a camera.
_MOST_PIXELS = 1 << 26


def crop_files(views: Path, name: str) -> tuple[Path, Path, Path]:
    """Return the paths of a view's colour, depth and description in the folder `views`; a name is a plain one."""
    plain_name(name)
    return views / f"{name}.color.png", views / f"{name}.depth.png", views / f"{name}.json"


def write_crop(views: Path, name: str, crop: Crop) -> None:
    """Write a view's pixels into the folder `views` (a map folder's `views/`) under `name` (`View.name`).

    Depth is rounded to millimetres; what is beyond 65.5 m becomes "no return".

    Raises:
        MapFolderError: the disk refused.
    """
    import cv2

    color_file, depth_file, description_file = crop_files(views, name)
    bgra = np.dstack([crop.rgb[..., ::-1], crop.mask.astype(np.uint8) * np.uint8(255)])
    description = {
        "camera": asdict(crop.camera),
        "world_from_camera": crop.world_from_camera.tolist(),
        "sensor": asdict(crop.sensor),
    }
    # Run lengths only: as small as level 1 on camera images and a third quicker.
    quick = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    with disk_errors(views):
        write_atomically(color_file, cv2.imencode(".png", bgra, quick)[1].tobytes(), sync=False)
        write_atomically(depth_file, cv2.imencode(".png", _millimetres(crop.depth_m), quick)[1].tobytes(), sync=False)
        write_atomically(description_file, dumps_exactly(description).encode(), sync=False)


def read_crop(views: Path, name: str) -> Crop:
    """Return the pixels of a view, depth to the millimetre.

    Raises:
        MapFolderError: a file is missing or damaged.
    """
    color_file, depth_file, description_file = crop_files(views, name)
    bgra = _read_png(color_file, np.dtype(np.uint8), 3)
    depth = _read_png(depth_file, np.dtype(np.uint16), 2)
    try:
        description = json.loads(read_within(views, description_file.name))
        return Crop(
            rgb=bgra[..., 2::-1],
            depth_m=np.where(depth == 0, np.float32(np.nan), depth.astype(np.float32) / np.float32(1000)),
            mask=bgra[..., 3] > 127,
            camera=Camera(**description["camera"]),
            world_from_camera=description["world_from_camera"],
            # Views of maps from before there was a sensor have none.
            sensor=DepthSensor(**description.get("sensor", {})),
        )
    except (OSError, KeyError, TypeError, ValueError, IndexError, RecursionError) as error:
        raise MapFolderError(f"view {name} in {views} is damaged: {error}; play the log again") from error


def _millimetres(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return a depth image in whole millimetres, 0 = no return."""
    millimetres = np.rint(np.nan_to_num(depth_m, nan=0.0, posinf=0.0, neginf=0.0) * np.float32(1000))
    return np.where((millimetres > 0) & (millimetres <= _MAX_MM), millimetres, 0).astype(np.uint16)


def _read_png(path: Path, dtype: np.dtype[Any], num_dimensions: int) -> NDArray[Any]:
    """Return the image of a file as it was stored."""
    import cv2

    try:
        data = read_within(path.parent, path.name)
        width, height = _png_size(data)
        if not (1 <= width <= MOST_SIDE_PX and 1 <= height <= MOST_SIDE_PX and width * height <= _MOST_PIXELS):
            raise ValueError(f"{width} x {height} pixels, which no view has")
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except (OSError, ValueError, cv2.error) as error:
        raise MapFolderError(f"cannot read {path}: {error}; play the log again") from error
    if image is None or image.dtype != dtype or image.ndim != num_dimensions:
        raise MapFolderError(f"{path} is no complete PNG image of a view; play the log again")
    return np.asarray(image)


def _png_size(data: bytes) -> tuple[int, int]:
    """Return width and height that a PNG claims, before memory is taken for them.

    Its checksums are looked at here: the decoder tells of a damaged file on the terminal, past everybody.
    """
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
