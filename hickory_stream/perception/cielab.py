"""Colours in CIE Lab, where Euclidean distance approximates perceived difference."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def lab_of(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (h, w, 3) CIE Lab of an image: lightness in 0..100."""
    return np.asarray(cv2.cvtColor(rgb.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB))
