"""Pre-processing of images: YOLOv8's letterbox, to the pixel; and normalisation as for ImageNet."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_GREY = 114


@dataclass(frozen=True, kw_only=True, slots=True)
class Letterbox:
    """An image in a network's frame, scaled to the inner size and beginning at (`left`, `top`); all in pixels."""

    width: int
    height: int
    frame_width: int
    frame_height: int
    inner_width: int
    inner_height: int
    left: int
    top: int

    def to_image(self, boxes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return boxes (N, 4) x0, y0, x1, y1 of the network's frame in the image, clipped to it."""
        shifted = boxes - np.array([self.left, self.top, self.left, self.top], dtype=np.float32)
        # Width and height were rounded to whole pixels separately, so that their scales differ.
        gain = np.array([self.inner_width / self.width, self.inner_height / self.height] * 2, dtype=np.float32)
        limits = np.array([self.width, self.height, self.width, self.height], dtype=np.float32)
        return np.asarray(np.clip(shifted / gain, 0, limits), dtype=np.float32)


def letterbox_of(width: int, height: int, frame_width: int, frame_height: int) -> Letterbox:
    """Return the letterbox of an image in a network's frame; all sizes in pixels."""
    scale = min(frame_height / height, frame_width / width)
    inner_width, inner_height = max(1, round(width * scale)), max(1, round(height * scale))
    return Letterbox(
        width=width,
        height=height,
        frame_width=frame_width,
        frame_height=frame_height,
        inner_width=inner_width,
        inner_height=inner_height,
        # An odd pixel goes to the right and the bottom.
        left=round((frame_width - inner_width) / 2 - 0.1),
        top=round((frame_height - inner_height) / 2 - 0.1),
    )


def letterboxed(rgb: NDArray[np.uint8], box: Letterbox) -> NDArray[np.float32]:
    """Return (1, 3, frame height, frame width) float32 in 0..1."""
    inner = rgb
    if (box.inner_width, box.inner_height) != (box.width, box.height):
        inner = cv2.resize(rgb, (box.inner_width, box.inner_height), interpolation=cv2.INTER_LINEAR)
    out = np.full((1, 3, box.frame_height, box.frame_width), np.float32(_GREY / 255), dtype=np.float32)
    rows, columns = slice(box.top, box.top + box.inner_height), slice(box.left, box.left + box.inner_width)
    for channel in range(3):
        np.multiply(inner[..., channel], np.float32(1 / 255), out=out[0, channel, rows, columns])
    return out


_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)


def normalised(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (1, 3, H, W) float32 of colour (H, W, 3) uint8, of zero mean and unit deviation on ImageNet."""
    out = np.empty((1, 3, *rgb.shape[:2]), dtype=np.float32)
    for channel, (mean, std) in enumerate(zip(_MEAN, _STD, strict=True)):
        np.multiply(rgb[..., channel], np.float32(1 / (255 * std)), out=out[0, channel])
        out[0, channel] -= np.float32(mean / std)
    return out


def built_in_picture() -> NDArray[np.uint8]:
    """Return (400, 600, 3) uint8: a cup of coffee from scikit-image (public domain), to test models."""
    from skimage.data import coffee

    return np.ascontiguousarray(coffee(), dtype=np.uint8)
