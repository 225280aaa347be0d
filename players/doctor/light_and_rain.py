"""Checks of light and weather: brightness and colour of images, and near specks of depth such as drops of rain."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.records import Frame

_STRIDE = 4
# In grey levels: images with a lower median are dark, and images whose channels differ by less are grey.
DARK, GREY = 12.0, 3.0
# A speck is narrower than this share of the image, and so much nearer than what is around it.
_ACROSS, _NEARER = 40, 1.2
# Clean logs have a share of up to 0.00015 in their median frame, drops on 0.3 % of the image 0.0012 to 0.0024.
RAIN = 0.001


@dataclass(frozen=True, kw_only=True, slots=True)
class Conditions:
    """Median brightness of an image and the difference of its channels, 0..255; share of returns that are specks."""

    brightness: float
    color: float
    specks: float


def conditions_of(frame: Frame) -> Conditions:
    """Return the conditions that a frame shows."""
    some = frame.rgb[::_STRIDE, ::_STRIDE].astype(np.int16)
    brightness, color = some.max(axis=-1), np.quantile(np.ptp(some, axis=-1), 0.9)
    return Conditions(brightness=float(np.median(brightness)), color=float(color), specks=_specks(frame.depth_m))


def _specks(depth_m: NDArray[np.float32]) -> float:
    # A closing by a line fills what is nearer than something on both sides of it (Serra 1982). A post is filled across
    # alone, a thing on the ground is not filled upright, and pixels without a return fill nothing.
    depth, side = np.nan_to_num(depth_m), depth_m.shape[1] // _ACROSS // 2 * 2 + 1
    lines = (np.ones((1, side)), np.ones((side, 1)), np.eye(side), np.eye(side)[::-1])
    filled = [cv2.morphologyEx(depth, cv2.MORPH_CLOSE, line.astype(np.uint8)) for line in lines]
    is_speck = np.min(filled, axis=0)[depth > 0] > _NEARER * depth[depth > 0]
    return float(is_speck.mean()) if is_speck.size else 0.0


def median_conditions(frames: Sequence[Conditions]) -> Conditions | None:
    """Return the conditions of a log: medians over its frames; None without frames."""
    rows = [asdict(frame) for frame in frames]
    return Conditions(**{name: float(np.median([row[name] for row in rows])) for name in rows[0]}) if rows else None
