"""The image on which models are tested: a cup of coffee on a table, from scikit-image (public domain)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def built_in_picture() -> NDArray[np.uint8]:
    """Return (400, 600, 3) uint8 colour."""
    from skimage.data import coffee

    return np.ascontiguousarray(coffee(), dtype=np.uint8)
