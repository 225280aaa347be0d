"""One colour per object id, the same in every view and in every run.

Hues step by the golden ratio, so that ids that follow one another, which often stand side by side, are far apart.
"""

from __future__ import annotations

import colorsys

_GOLDEN_RATIO = 0.6180339887498949
_SATURATIONS = (0.72, 0.5, 0.88)


def color_of_id(object_id: int) -> tuple[int, int, int]:
    """Return the (r, g, b) uint8 colour of an object."""
    hue = (0.07 + object_id * _GOLDEN_RATIO) % 1.0
    r, g, b = colorsys.hsv_to_rgb(hue, _SATURATIONS[object_id % len(_SATURATIONS)], 0.96)
    return round(255 * r), round(255 * g), round(255 * b)


def shaded(color: tuple[int, int, int], factor: float) -> tuple[int, int, int]:
    """Return a colour made darker (factor < 1) or, up to white, lighter (factor > 1)."""
    if factor <= 1.0:
        r, g, b = (round(factor * c) for c in color)
    else:
        r, g, b = (round(255 - (255 - c) / factor) for c in color)
    return r, g, b


def readable_on_dark(color: tuple[int, int, int]) -> tuple[int, int, int]:
    """Return a colour mixed with white until text in it can be read on a dark ground (Rec. 601 luma of 150)."""
    luma = 0.299 * color[0] + 0.587 * color[1] + 0.114 * color[2]
    share = max(0.0, (150.0 - luma) / (255.0 - luma)) if luma < 255.0 else 0.0
    r, g, b = (round(c + share * (255 - c)) for c in color)
    return r, g, b
