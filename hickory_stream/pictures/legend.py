"""Legends of pictures, and the tint of generated surface, which pictures, pages, exports and the viewer share."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.display import color_of_id
from hickory_stream.textures.textured_mesh import TexturedMesh

Color = tuple[int, int, int]
GENERATED: Color = (226, 64, 200)
"""Tint of surface that no view shows: a reconstructor generated it."""
GENERATED_TEXT = "generated: no view shows this surface"
FIXTURE: Color = color_of_id(7, is_fixture=True)
"""Tint of fixtures."""
FIXTURE_TEXT = "fixture: built in, attached, or too large to be carried"
_SHARE = 0.45
_ROW_PX, _SWATCH_PX, _GAP_PX, _SIZE = 22, 12, 18, 0.45


def with_tint(colors: NDArray[np.uint8], is_seen: NDArray[Any], tint: Color = GENERATED) -> NDArray[np.uint8]:
    """Return colours (..., 3), mixed with a tint where not `is_seen` (...)."""
    tinted = np.round((1 - _SHARE) * colors + _SHARE * np.array(tint))
    return np.where(is_seen[..., None], colors, tinted).astype(np.uint8)


def with_tinted_image(textured: TexturedMesh) -> NDArray[np.uint8]:
    """Return the image of a mesh, tinted on the faces that have generated vertices alone."""
    import cv2

    is_seen = np.ones(textured.image.shape[:2], np.uint8)
    corners = np.round(16 * (textured.uv * len(textured.image) - 0.5)).astype(np.int32)
    for face in textured.mesh.faces[~textured.mesh.is_seen[textured.mesh.faces].any(axis=1)]:
        cv2.fillConvexPoly(is_seen, corners[face], 0, cv2.LINE_8, shift=4)
    return with_tint(textured.image, is_seen.astype(bool))


def legend_of(
    entries: Sequence[tuple[str, Color]], width: int, *, ink: Color = (50, 54, 62), ground: Color = (255, 255, 255)
) -> NDArray[np.uint8]:
    """Return a picture (H, W, 3) of swatches with texts, in as many rows of `width` pixels as they need."""
    import cv2

    x, y, places = _GAP_PX, 0, []
    for text, _ in entries:
        (length, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _SIZE, 1)
        step = _SWATCH_PX + 6 + length + _GAP_PX
        if x + step > width and x > _GAP_PX:
            x, y = _GAP_PX, y + _ROW_PX
        places.append((x, y))
        x += step
    image = np.full((y + _ROW_PX, width, 3), ground, dtype=np.uint8)
    for (text, color), (x, y) in zip(entries, places, strict=True):
        low = y + (_ROW_PX + _SWATCH_PX) // 2
        cv2.rectangle(image, (x, low - _SWATCH_PX), (x + _SWATCH_PX, low), color, cv2.FILLED)
        cv2.rectangle(image, (x, low - _SWATCH_PX), (x + _SWATCH_PX, low), ink, 1)
        place = (x + _SWATCH_PX + 6, low - 1)
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, _SIZE, ink, 1, cv2.LINE_AA)
    return image


def draw_legend(image: NDArray[np.uint8], entries: Sequence[tuple[str, Color]]) -> None:
    """Draw a legend over the lower right corner of a view."""
    legend = legend_of(entries, image.shape[1])
    end = int(np.flatnonzero((legend != 255).any(axis=(0, 2)))[-1]) + _GAP_PX
    image[-len(legend) :, -end:] = legend[:, :end]
