"""The pixels of a kept view as files: colour with the mask as alpha, depth in millimetres, camera and pose.

Colour may be lossy (`run.view_colors`): the mask then is a file of its own, as exact as ever, and the description has
the checksum of the colour's file, as neither JPEG nor WebP has one. Which it is, the files say.

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
from hickory_stream.engine.image_files import lossy_bytes, png_bytes, read_image
from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.json_text import dumps_exactly
from hickory_stream.ports import Crop

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.config import RunConfig

_MAX_MM = 65535
_LOSSY = {"jpeg": ".jpg", "webp": ".webp"}
# WebP has 14 bits for a side; a longer one is written as PNG.
_MOST_LOSSY_SIDE_PX = 16383


def crop_files(views: Path, name: str) -> tuple[Path, ...]:
    """Return the paths of a view's colour, depth, mask and description in the folder `views`; a name is a plain one.

    They have a mask where a lossy colour is there; of a view that is not there they are those of one in PNG.
    """
    plain_name(name)
    depth, mask, description = views / f"{name}.depth.png", views / f"{name}.mask.png", views / f"{name}.json"
    for suffix in _LOSSY.values():
        color = views / f"{name}.color{suffix}"
        if color.exists():
            return color, depth, mask, description
    return views / f"{name}.color.png", depth, description


def write_crop(views: Path, name: str, crop: Crop, how: RunConfig | None = None) -> None:
    """Write a view's pixels into the folder `views` (a map folder's `views/`) under `name` (`View.name`).

    Depth is rounded to millimetres; what is beyond 65.5 m becomes "no return". Colour is as `how.view_colors` says,
    exact without it.

    Raises:
        MapFolderError: the disk refused.
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
    """Return the pixels of a view, depth to the millimetre.

    Raises:
        MapFolderError: a file is missing or damaged.
    """
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
            # Views of maps from before there was a sensor have none.
            sensor=DepthSensor(**description.get("sensor", {})),
        )
    except (OSError, KeyError, TypeError, ValueError, IndexError, RecursionError) as error:
        raise MapFolderError(f"view {name} in {views} is damaged: {error}; play the log again") from error


def read_mask(views: Path, name: str) -> NDArray[np.bool_]:
    """Return the mask of a view alone, as `read_crop` has it.

    Raises:
        MapFolderError: its file is missing or damaged.
    """
    color_file, _, *mask_file, _ = crop_files(views, name)
    try:
        if mask_file:
            return np.asarray(read_image(mask_file[0], np.dtype(np.uint8), 2) > 127)
        return np.asarray(read_image(color_file, np.dtype(np.uint8), 3)[..., 3] > 127)
    except (OSError, ValueError, IndexError) as error:
        raise MapFolderError(f"view {name} in {views} is damaged: {error}; play the log again") from error


def _millimetres(depth_m: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return a depth image in whole millimetres, 0 = no return."""
    with np.errstate(invalid="ignore", over="ignore"):
        millimetres = np.rint(depth_m * np.float32(1000))
        # What is no number is neither.
        return np.where((millimetres > 0) & (millimetres <= _MAX_MM), millimetres, 0).astype(np.uint16)
