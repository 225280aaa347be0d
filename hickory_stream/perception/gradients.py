"""Gradients of an image after a Gaussian blur, in single precision and with a fixed order of operations.

OpenCV's floating-point filters use fused multiply-add only on processors that have it: results would differ.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.compiled import numba
from hickory_stream.geometry import portable

if TYPE_CHECKING:
    from numpy.typing import NDArray


def gradients(image: NDArray[np.float32], sigma_px: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return (h, w) the differences along x and y of a blurred image (h, w), by Sobel's operator.

    The image is extended beyond its border by reflection at the outermost pixel.
    """
    radius = max(1, round(4 * sigma_px))
    weights = portable.gaussian_weights(sigma_px, radius).astype(np.float32)
    blurred = _blurred(_mirrored(image, radius), weights)
    along_x, along_y = _sobel(_mirrored(blurred, 1))
    return along_x, along_y


def _mirrored(image: NDArray[np.float32], radius: int) -> NDArray[np.float32]:
    return np.asarray(cv2.copyMakeBorder(image, radius, radius, radius, radius, cv2.BORDER_REFLECT_101))


@numba.njit(cache=True, nogil=True)
def _blurred(padded, weights):  # type: ignore[no-untyped-def] # pragma: no cover
    """Weight along the rows, then along the columns; the innermost loop runs along a row and is vectorised."""
    height, width = padded.shape[0] - len(weights) + 1, padded.shape[1] - len(weights) + 1
    rows = np.zeros((padded.shape[0], width), dtype=np.float32)
    for y in range(padded.shape[0]):
        for k in range(len(weights)):
            for x in range(width):
                rows[y, x] += weights[k] * padded[y, x + k]
    out = np.zeros((height, width), dtype=np.float32)
    for y in range(height):
        for k in range(len(weights)):
            for x in range(width):
                out[y, x] += weights[k] * rows[y + k, x]
    return out


@numba.njit(cache=True, nogil=True)
def _sobel(p):  # type: ignore[no-untyped-def] # pragma: no cover
    height, width = p.shape[0] - 2, p.shape[1] - 2
    along_x, along_y = np.empty((height, width), dtype=np.float32), np.empty((height, width), dtype=np.float32)
    two = np.float32(2.0)
    for y in range(height):
        for x in range(width):
            left = p[y, x] + two * p[y + 1, x] + p[y + 2, x]
            right = p[y, x + 2] + two * p[y + 1, x + 2] + p[y + 2, x + 2]
            above = p[y, x] + two * p[y, x + 1] + p[y, x + 2]
            below = p[y + 2, x] + two * p[y + 2, x + 1] + p[y + 2, x + 2]
            along_x[y, x], along_y[y, x] = right - left, below - above
    return along_x, along_y
