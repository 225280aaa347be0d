"""Masks of a frame: overlapping ones as networks give them, and label images with what is measured on them."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.arrays import freeze, read_only


def label_boxes(labels: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Return (count, 4) x0, y0, x1, y1 of each label, ends exclusive; 0 of a label without a pixel."""
    boxes = np.zeros((count, 4), dtype=np.int64)
    _fill_boxes(read_only(labels), boxes)
    return boxes


@kernel
def _fill_boxes(labels, boxes):
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            i = labels[y, x]
            if i > 0:
                if boxes[i, 3] == 0:
                    boxes[i, 0], boxes[i, 1] = x, y
                boxes[i, 0], boxes[i, 2] = min(boxes[i, 0], x), max(boxes[i, 2], x + 1)
                boxes[i, 3] = y + 1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InstanceMask:
    """A mask that may overlap others: `mask` (h, w) bool within `box_px` = (x0, y0, x1, y1), ends exclusive."""

    box_px: tuple[int, int, int, int]
    mask: NDArray[np.bool_]
    score: float = 1.0

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box_px
        freeze(self, "mask", np.bool_, (y1 - y0, x1 - x0))


def enlarged(labels: NDArray[np.int32], factor: int, size: tuple[int, int]) -> NDArray[np.int32]:
    """Return labels at the size of the frame (width, height), padded with 0 where the reduction truncated."""
    if factor == 1:
        return labels.astype(np.int32)
    shape = (labels.shape[1] * factor, labels.shape[0] * factor)
    # Nearest neighbour copies bits, and cv2 resizes no int32.
    big = cv2.resize(labels.view(np.float32), shape, interpolation=cv2.INTER_NEAREST)
    return _filled_up(big.view(np.int32), size)


def enlarged_mask(mask: NDArray[np.bool_], factor: int, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return a mask at the size of the frame (width, height), padded with False where the reduction truncated."""
    shape = (mask.shape[1] * factor, mask.shape[0] * factor)
    return _filled_up(cv2.resize(mask.view(np.uint8), shape, interpolation=cv2.INTER_NEAREST).view(np.bool_), size)


def _filled_up(image: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    # An image (h, w) with zeros to the right and below up to a size (width, height).
    if image.shape == (size[1], size[0]):
        return image
    large = np.zeros((size[1], size[0]), dtype=image.dtype)
    large[: image.shape[0], : image.shape[1]] = image
    return large
