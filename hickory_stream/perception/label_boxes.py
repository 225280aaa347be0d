"""The bounding boxes of the labels of an image."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import find_objects

if TYPE_CHECKING:
    from numpy.typing import NDArray


def label_boxes(labels: NDArray[np.int32], count: int) -> NDArray[np.int64]:
    """Return (count, 4) x0, y0, x1, y1 of each label, ends exclusive."""
    boxes = np.zeros((count, 4), dtype=np.int64)
    for i, place in enumerate(find_objects(labels, max_label=count - 1)):
        if place is not None:
            rows, columns = place
            boxes[i + 1] = columns.start, rows.start, columns.stop, rows.stop
    return boxes
