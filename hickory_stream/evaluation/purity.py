"""Mask purity: the share of a kept view's mask that shows one true object."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def purity(mask: NDArray[np.bool_], box_px: tuple[int, int, int, int], instances: NDArray[np.uint16]) -> float | None:
    """Return the share of a mask's pixels that show its most frequent true instance; the background counts as one.

    `mask` is cut out along its bounds `box_px` (x0, y0, x1, y1) in the (H, W) image. None if it is empty, or if the
    bounds are not those of the mask or exceed the image.
    """
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    x0, y0, x1, y1 = box_px
    if len(rows) == 0 or y1 > instances.shape[0] or x1 > instances.shape[1]:
        return None
    inner = mask[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    shown = instances[y0:y1, x0:x1]
    if inner.shape != shown.shape:
        return None
    _, counts = np.unique(shown[inner], return_counts=True)
    return float(counts.max() / counts.sum())
