"""The checks of a log's colour images by `doctor`: brightness, and whether they have colour at all."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_STRIDE = 4
# Of 255: what is darker has no colour to speak of, and where channels differ by less there is none.
_DARK, _GREY = 12.0, 3.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Light:
    """The brightness of half of the pixels is below `median`; `color`: how far the channels are apart, both of 255."""

    median: float
    color: float

    @property
    def is_dark(self) -> bool:
        """Whether the image shows next to nothing."""
        return self.median < _DARK

    @property
    def is_grey(self) -> bool:
        """Whether the image has brightness only."""
        return self.color < _GREY


def light_of(rgb: NDArray[np.uint8]) -> Light:
    """Return the light of an image (H, W, 3)."""
    some = rgb[::_STRIDE, ::_STRIDE].astype(np.int16)
    apart = some.max(axis=-1) - some.min(axis=-1)
    return Light(median=float(np.median(some.max(axis=-1))), color=float(np.quantile(apart, 0.9)))


def light_of_all(frames: Sequence[Light]) -> Light | None:
    """Return the light of a log: the median over its frames; None where there are none."""
    if not frames:
        return None
    return Light(
        median=float(np.median([light.median for light in frames])),
        color=float(np.median([light.color for light in frames])),
    )
