"""Checks of colour images: brightness, and whether they have colour."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_STRIDE = 4
# In grey levels: images with a lower median are dark, and images whose channels differ by less are grey.
_DARK, _GREY = 12.0, 3.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Brightness:
    """Brightness and colour of an image, 0..255: `median` of the brightness, `color` the difference of the channels."""

    median: float
    color: float

    @property
    def is_dark(self) -> bool:
        """Whether the image is too dark to show objects."""
        return self.median < _DARK

    @property
    def is_grey(self) -> bool:
        """Whether the image has no colour."""
        return self.color < _GREY


def brightness_of(rgb: NDArray[np.uint8]) -> Brightness:
    """Return the brightness and colour of an image (H, W, 3)."""
    some = rgb[::_STRIDE, ::_STRIDE].astype(np.int16)
    apart = some.max(axis=-1) - some.min(axis=-1)
    return Brightness(median=float(np.median(some.max(axis=-1))), color=float(np.quantile(apart, 0.9)))


def median_brightness(frames: Sequence[Brightness]) -> Brightness | None:
    """Return the brightness and colour of a log: medians over its frames; None without frames."""
    median, color = ([getattr(light, name) for light in frames] for name in ("median", "color"))
    return Brightness(median=float(np.median(median)), color=float(np.median(color))) if frames else None
