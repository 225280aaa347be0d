"""Names of colours as regions of CIE Lab: the eleven basic terms of Berlin and Kay (1969), and beige.

Hue and chroma decide first, since lightness depends on shade.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

COLOR_NAMES = ("black", "gray", "white", "red", "orange", "brown", "beige", "yellow", "green", "blue", "purple", "pink")

# Below this chroma a colour is black, gray or white, by its lightness.
_GRAY_CHROMA = 10.0
_BLACK_BELOW, _WHITE_ABOVE = 28.0, 80.0
# Upper ends of the hues, degrees of CIE Lab; red continues from 345 past 0.
_HUE_ENDS_DEG = (42.0, 68.0, 105.0, 195.0, 300.0, 345.0)
_HUE_NAMES = ("red", "orange", "yellow", "green", "blue", "purple", "red")
# Orange and yellow of little chroma are brown where dark and beige where light; red that is light is pink.
_BROWN_CHROMA, _BROWN_BELOW, _BEIGE_CHROMA = 52.0, 62.0, 36.0
_PINK_ABOVE, _PINK_CHROMA = 62.0, 60.0


def name_shares(colors: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the share of (N, 3) RGB colours with each of `COLOR_NAMES`; all 0 for none."""
    if not len(colors):
        return np.zeros(len(COLOR_NAMES))
    counts = np.bincount(named(colors), minlength=len(COLOR_NAMES))
    return counts / len(colors)


def named(colors: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return the index in `COLOR_NAMES` of each of (N, 3) RGB colours."""
    lab = cv2.cvtColor(colors[None].astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)[0]
    lightness, chroma = lab[:, 0], np.hypot(lab[:, 1], lab[:, 2])
    hue_deg = np.degrees(np.arctan2(lab[:, 2], lab[:, 1])) % 360.0
    by_hue = np.array([COLOR_NAMES.index(name) for name in _HUE_NAMES])[np.searchsorted(_HUE_ENDS_DEG, hue_deg)]
    is_warm = np.isin(by_hue, [COLOR_NAMES.index(name) for name in ("orange", "yellow")])
    is_red = by_hue == COLOR_NAMES.index("red")
    choices = (
        (chroma < _GRAY_CHROMA) & (lightness < _BLACK_BELOW),
        (chroma < _GRAY_CHROMA) & (lightness > _WHITE_ABOVE),
        chroma < _GRAY_CHROMA,
        is_warm & (chroma < _BROWN_CHROMA) & (lightness < _BROWN_BELOW),
        is_warm & (chroma < _BEIGE_CHROMA),
        is_red & (lightness > _PINK_ABOVE) & (chroma < _PINK_CHROMA),
    )
    names = ("black", "white", "gray", "brown", "beige", "pink")
    return np.select(choices, [COLOR_NAMES.index(name) for name in names], by_hue)
