"""Text on pictures: ids at the objects, the title, the scale."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_PADDING_PX = 3


def draw_labels(
    image: NDArray[np.uint8], places_px: NDArray[np.float64], labels: list[tuple[str, tuple[int, int, int]]]
) -> None:
    """Write texts at (N, 2) places, each on a patch of its colour; one that would cover another moves up."""
    import cv2

    font, size, thickness = cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1
    taken: list[tuple[int, int, int, int]] = []
    for i in np.argsort(-places_px[:, 1], kind="stable"):
        text, color = labels[i]
        (width, height), _ = cv2.getTextSize(text, font, size, thickness)
        x0, y1 = round(places_px[i, 0] - width / 2 - _PADDING_PX), round(places_px[i, 1])
        box = (x0, y1 - height - 2 * _PADDING_PX, x0 + width + 2 * _PADDING_PX, y1)
        while any(_overlap(box, other) for other in taken):
            box = (box[0], box[1] - 2, box[2], box[3] - 2)
        taken.append(box)
        cv2.rectangle(image, box[:2], box[2:], tuple(int(0.55 * c) for c in color), cv2.FILLED, cv2.LINE_AA)
        place = (box[0] + _PADDING_PX, box[3] - _PADDING_PX)
        cv2.putText(image, text, place, font, size, (255, 255, 255), thickness, cv2.LINE_AA)


def draw_title(image: NDArray[np.uint8], text: str) -> None:
    """Fill a strip with a title."""
    import cv2

    image[:] = (38, 42, 50)
    cv2.putText(image, text, (16, image.shape[0] - 15), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (240, 240, 240), 1, cv2.LINE_AA)


def draw_scale(image: NDArray[np.uint8], pixels_per_m: float) -> None:
    """Draw a bar of one metre, and the directions of x and y, into the lower left corner of a view from above."""
    import cv2

    x, y, color = 16, image.shape[0] - 16, (70, 75, 85)
    length = round(pixels_per_m)
    cv2.line(image, (x, y), (x + length, y), color, 2, cv2.LINE_AA)
    for end in (x, x + length):
        cv2.line(image, (end, y - 4), (end, y + 4), color, 1, cv2.LINE_AA)
    cv2.putText(image, "1 m", (x + length + 8, y + 5), cv2.FONT_HERSHEY_SIMPLEX, 0.45, color, 1, cv2.LINE_AA)


def _overlap(a: tuple[int, int, int, int], b: tuple[int, int, int, int]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
