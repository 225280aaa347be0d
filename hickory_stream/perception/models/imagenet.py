"""The pre-processing that networks trained on ImageNet share: its mean and standard deviation, per channel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_MEAN = (0.485, 0.456, 0.406)
_STD = (0.229, 0.224, 0.225)


def normalised(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (1, 3, H, W) float32 of colour (H, W, 3) uint8, of zero mean and unit deviation on ImageNet."""
    out = np.empty((1, 3, *rgb.shape[:2]), dtype=np.float32)
    for channel, (mean, std) in enumerate(zip(_MEAN, _STD, strict=True)):
        np.multiply(rgb[..., channel], np.float32(1 / (255 * std)), out=out[0, channel])
        out[0, channel] -= np.float32(mean / std)
    return out
