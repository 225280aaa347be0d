"""Pre-processing of a picture for a vision graph, as its published `preprocessor_config.json` says.

Pillow resizes, with its own anti-aliasing, as in training; OpenCV's result would differ by more than a network bears.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ModelError

_MOST_SIDE_PX = 4096
# Pillow's numbers of nearest, Lanczos, bilinear, bicubic, box and Hamming.
_RESAMPLINGS = range(6)


@dataclass(frozen=True, kw_only=True, slots=True)
class Preprocessing:
    """The pre-processing of a picture."""

    #: its new shorter side; 0 if `size_px` gives both
    short_px: int
    #: its new height and width; None if `short_px` gives one
    size_px: tuple[int, int] | None
    #: height and width of the middle that is kept; None: all of it
    crop_px: tuple[int, int] | None
    #: Pillow's number of the filter
    resampling: int
    #: factor of values 0..255
    scale: float
    #: per channel, after scaling, like `std`
    mean: tuple[float, float, float]
    std: tuple[float, float, float]


def read_preprocessing(path: Path) -> Preprocessing:
    """Return the pre-processing of a `preprocessor_config.json`; raises `ModelError` if it is invalid."""
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        return _preprocessing(said)
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ModelError(
            f"{path} says no pre-processing ({type(error).__name__}: {error}); expected size, crop_size, resample, "
            "image_mean and image_std as image-text networks are published with"
        ) from error


def pixels_of(rgb: NDArray[np.uint8], how: Preprocessing) -> NDArray[np.float32]:
    """Return (1, 3, h, w) float32 of a picture (H, W, 3) uint8."""
    from PIL import Image

    height, width = rgb.shape[:2]
    if how.size_px is not None:
        new_height, new_width = how.size_px
    else:
        factor = how.short_px / min(height, width)
        new_height = how.short_px if height <= width else int(factor * height)
        new_width = how.short_px if width <= height else int(factor * width)
    picture = Image.fromarray(np.ascontiguousarray(rgb))
    resized = np.asarray(picture.resize((new_width, new_height), resample=Image.Resampling(how.resampling)))
    if how.crop_px is not None:
        top, left = (new_height - how.crop_px[0]) // 2, (new_width - how.crop_px[1]) // 2
        resized = resized[top : top + how.crop_px[0], left : left + how.crop_px[1]]
    scaled = resized.astype(np.float32) * np.float32(how.scale)
    normal = (scaled - np.asarray(how.mean, np.float32)) / np.asarray(how.std, np.float32)
    return np.ascontiguousarray(normal.transpose(2, 0, 1)[None])


def _preprocessing(said: dict[str, Any]) -> Preprocessing:
    size = said["size"]
    # Files of older releases have a plain number: the shorter side.
    short_px = size if isinstance(size, int) else size.get("shortest_edge", 0)
    size_px = None if short_px else _height_width(size)
    crop_px = _height_width(said["crop_size"]) if said.get("do_center_crop", False) else None
    least = (short_px, short_px) if size_px is None else size_px
    if not 0 < max(least) <= _MOST_SIDE_PX:
        raise ValueError(f"size {size}, expected 1 to {_MOST_SIDE_PX} pixels")
    if crop_px is not None and not all(0 < part <= whole for part, whole in zip(crop_px, least, strict=True)):
        raise ValueError(f"crop_size {crop_px} of a picture of {least}")
    resampling = int(said.get("resample", 3))
    if resampling not in _RESAMPLINGS:
        raise ValueError(f"resample {resampling}, expected 0 to {_RESAMPLINGS[-1]}")
    is_normalised = said.get("do_normalize", True)
    return Preprocessing(
        short_px=short_px,
        size_px=size_px,
        crop_px=crop_px,
        resampling=resampling,
        scale=float(said.get("rescale_factor", 1 / 255)) if said.get("do_rescale", True) else 1.0,
        mean=_channels(said["image_mean"]) if is_normalised else (0.0, 0.0, 0.0),
        std=_channels(said["image_std"], least=1e-6) if is_normalised else (1.0, 1.0, 1.0),
    )


def _height_width(size: Any) -> tuple[int, int]:
    height, width = (size, size) if isinstance(size, int) else (size["height"], size["width"])
    return int(height), int(width)


def _channels(values: Any, least: float = -np.inf) -> tuple[float, float, float]:
    red, green, blue = (float(value) for value in values)
    if not all(np.isfinite(value) and value >= least for value in (red, green, blue)):
        raise ValueError(f"found {values}, expected three finite numbers")
    return red, green, blue
