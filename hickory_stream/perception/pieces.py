"""What is measured of every fragment before the rules of joining look at it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np
from scipy.ndimage import find_objects

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface

_HEIGHT_BIN_M = 0.004


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Pieces:
    """Per fragment (index = label): all arrays are (count, ...), row 0 is nothing.

    `pixels`; `lab` (count, 3) the mean colour; `z_low_m` and `z_high_m` the 5th and 95th percentile of height;
    `area_m2` of surface in view; `support`: the supporting plane that most of it lies in, 0 = none;
    `center_m` (count, 2): the mean of its points, seen from above.
    """

    pixels: NDArray[np.int64]
    lab: NDArray[np.float64]
    z_low_m: NDArray[np.float64]
    z_high_m: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    support: NDArray[np.int64]
    center_m: NDArray[np.float64]

    def color_difference(self, a: int, b: int) -> float:
        """Return the distance of two mean colours in Lab, lightness at half weight: shading changes lightness."""
        light, green, blue = self.lab[a] - self.lab[b]
        return float(np.sqrt(0.25 * light * light + green * green + blue * blue))


def measure(
    surface: Surface, labels: NDArray[np.int32], supports: NDArray[np.int32], areas_m2: NDArray[np.float32]
) -> Pieces:
    """Return the measures of the fragments `labels` (h, w)."""
    count = int(labels.max()) + 1
    used = np.flatnonzero(labels.ravel())
    names = labels.ravel()[used]
    pixels = np.bincount(names, minlength=count)
    per = np.maximum(pixels, 1)
    lab_image = lab_of(surface.rgb).reshape(-1, 3)[used]
    lab = np.stack([np.bincount(names, weights=lab_image[:, c], minlength=count) / per for c in range(3)], axis=1)
    points = surface.points_world.reshape(-1, 3)[used]
    low, high = _percentiles(names, points[:, 2], pixels)
    planes = supports.ravel()[used]
    levels = int(planes.max(initial=0)) + 1
    votes = np.bincount(names.astype(np.int64) * levels + planes, minlength=count * levels).reshape(count, levels)
    most = votes.argmax(axis=1)
    center = np.stack([np.bincount(names, weights=points[:, c], minlength=count) / per for c in range(2)], axis=1)
    return Pieces(
        pixels=pixels,
        lab=lab,
        z_low_m=low,
        z_high_m=high,
        area_m2=np.bincount(names, weights=areas_m2.ravel()[used], minlength=count).astype(np.float64),
        support=np.where(2 * votes[:, 0] < pixels, most, 0),
        center_m=center,
    )


def label_boxes(labels: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Return (count, 4) x0, y0, x1, y1 of each label, ends exclusive."""
    boxes = np.zeros((count, 4), dtype=np.int64)
    for i, place in enumerate(find_objects(labels, max_label=count - 1)):
        if place is not None:
            rows, columns = place
            boxes[i + 1] = columns.start, rows.start, columns.stop, rows.stop
    return boxes


def lab_of(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (h, w, 3) CIE Lab of an image: lightness in 0..100."""
    return np.asarray(cv2.cvtColor(rgb.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB))


def _percentiles(
    names: NDArray[np.int32], z: NDArray[np.float32], pixels: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the 5th and 95th percentile of each label's heights, to 4 mm: from histograms, sorting takes longer."""
    if len(z) == 0:
        return np.zeros(len(pixels)), np.zeros(len(pixels))
    bottom = float(z.min())
    bin_index = ((z - bottom) / _HEIGHT_BIN_M).astype(np.int64)
    bins = int(bin_index.max()) + 1
    histogram = np.bincount(names.astype(np.int64) * bins + bin_index, minlength=len(pixels) * bins)
    below = np.cumsum(histogram.reshape(len(pixels), bins), axis=1)
    low, high = ((below < share * pixels[:, None]).sum(axis=1) for share in (0.05, 0.95))
    return bottom + (low + 0.5) * _HEIGHT_BIN_M, bottom + (high + 0.5) * _HEIGHT_BIN_M
