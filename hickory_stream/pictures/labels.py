"""Text on pictures: ids at the objects, the title, the scale.

A label lies on the visible part of its object. If that is too small, it stands beside it with a leader line.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.display import color_of_id

_PADDING_PX = 3
_SIZE, _THICKNESS = 0.45, 1
# Candidate positions of a label around its anchor: distances, and directions with "above" first.
_DISTANCES_PX = (22, 30, 40, 52, 66, 82, 100, 120, 145, 175, 210, 250)
_ANGLES_RAD = np.deg2rad([90, 60, 120, 30, 150, 0, 180, -30, -150, -60, -120, -90])
# Cost of covering other objects: a label entirely over other objects costs as much as this many pixels of distance.
_COVERING_PX = 60.0
_STEP_PX = 3
_NONE: Mapping[int, Any] = {}
# Labels together cover at most this share of the visible objects; so many objects have one in any case.
_MOST_COVERED, _ALWAYS = 0.5, 30


@dataclass(frozen=True, kw_only=True, slots=True)
class Label:
    """A label: its rectangle `box_px` (x0, y0, x1, y1), end exclusive, its anchor (x, y) on the object, its text."""

    object_id: int
    box_px: tuple[int, int, int, int]
    place_px: tuple[int, int]
    text: str = ""

    @property
    def is_beside(self) -> bool:
        """Whether it stands beside its anchor, so that a leader line is drawn."""
        return not _holds(self.box_px, self.place_px)


def most_visible(ids: Sequence[int], owners: NDArray[np.int32], step_px: int) -> list[int]:
    """Return the ids to label: all, or the most visible ones that cover half of the visible area.

    `owners` (h, w) is the id of the object visible in each square of `step_px` pixels, -1 for none.
    """
    seen, counts = np.unique(owners[owners >= 0], return_counts=True)
    squares = dict(zip(seen.tolist(), counts.tolist(), strict=True))
    ordered = sorted(ids, key=lambda i: (-squares.get(i, 0), i))
    sizes = np.array([_text_size(str(i)) for i in ordered]).reshape(-1, 2).prod(axis=1)
    room_px2 = _MOST_COVERED * step_px**2 * int(counts.sum())
    return ordered[: max(_ALWAYS, int(np.searchsorted(np.cumsum(sizes), room_px2)))]


def place_labels(
    ids: Sequence[int],
    owners: NDArray[np.int32],
    step_px: int,
    hidden_px: NDArray[np.float64],
    texts: Mapping[int, str] = _NONE,
) -> list[Label]:
    """Return a label for each of N ids, in their order; no two overlap if there is room.

    `owners` (h, w) is the id of the object visible in each square of `step_px` pixels, -1 for none; `hidden_px` (N, 2)
    are the anchors of objects that are not visible. A text is the id, if `texts` has no other.
    """
    texts = {i: texts.get(i, str(i)) for i in ids}
    sizes = {i: _text_size(text) for i, text in texts.items()}
    spots = {i: _spot(owners == i, step_px, sizes[i], hidden) for i, hidden in zip(ids, hidden_px, strict=True)}
    limits = (owners.shape[1] * step_px, owners.shape[0] * step_px)
    placed: dict[int, Label] = {}
    # Labels that fit on their objects are placed first, then the others from the bottom of the picture up.
    ordered = sorted(ids, key=lambda i: (spots[i][1] < sizes[i][0] / 2, -spots[i][0][1], i))
    for object_id in ordered:
        others = [spots[i][0] for i in ids if i != object_id]
        placed[object_id] = _placed(
            object_id, texts[object_id], *spots[object_id], list(placed.values()), others, owners, step_px, limits
        )
    return [placed[object_id] for object_id in ids]


def flat_labels(
    outlines: Mapping[int, Sequence[NDArray[Any]]], size: tuple[int, int], texts: Mapping[int, str] = _NONE
) -> list[Label]:
    """Return labels of objects in a plan of `size` (W, H) pixels, from the (N, 2) outlines of their parts.

    Objects with a smaller extent lie above larger ones; of a crowd the most visible objects have labels.
    """
    import cv2

    owners = np.full((size[1] // _STEP_PX, size[0] // _STEP_PX), -1, dtype=np.int32)
    ends = {i: np.concatenate(parts) for i, parts in outlines.items()}
    for i in sorted(outlines, key=lambda i: (-float(np.ptp(ends[i], axis=0).prod()), i)):
        for part in outlines[i]:
            cv2.fillPoly(owners, [np.round(part / _STEP_PX).astype(np.int32)], i)
    chosen = set(most_visible(list(outlines), owners, _STEP_PX))
    ids = [i for i in outlines if i in chosen]
    middles = np.array([ends[i].mean(axis=0) for i in ids]).reshape(-1, 2)
    return place_labels(ids, owners, _STEP_PX, middles, texts)


def draw_labels(
    image: NDArray[np.uint8], labels: Sequence[Label], colors: Mapping[int, tuple[int, int, int]] = _NONE
) -> None:
    """Draw the labels on patches of `colors`, if that has none of their ids' colours, with leader lines."""
    import cv2

    dark = {i: _dark(colors.get(i, color_of_id(i))) for i in (label.object_id for label in labels)}
    for label in (label for label in labels if label.is_beside):
        x0, y0, x1, y1 = label.box_px
        x, y = label.place_px
        near = (int(np.clip(x, x0, x1 - 1)), int(np.clip(y, y0, y1 - 1)))
        for color, thickness in (((255, 255, 255), 3), (dark[label.object_id], 1)):
            cv2.line(image, near, (x, y), color, thickness, cv2.LINE_AA)
            cv2.circle(image, (x, y), 1 + thickness // 2, color, cv2.FILLED, cv2.LINE_AA)
    for label in labels:
        x0, y0, x1, y1 = label.box_px
        cv2.rectangle(image, (x0, y0), (x1 - 1, y1 - 1), dark[label.object_id], cv2.FILLED)
        place = (x0 + _PADDING_PX, y1 - 1 - _PADDING_PX)
        text = label.text or str(label.object_id)
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, _SIZE, (255, 255, 255), _THICKNESS, cv2.LINE_AA)


def _spot(
    seen: NDArray[np.bool_], step_px: int, size_px: tuple[int, int], hidden_px: NDArray[np.float64]
) -> tuple[tuple[int, int], float]:
    # The anchor is nearest to the region's centre where the label fits, else farthest from the edge; its distance from
    # the edge is in pixels.
    import cv2

    if not seen.any():
        return (round(float(hidden_px[0])), round(float(hidden_px[1]))), 0.0
    depth = cv2.distanceTransform(np.pad(seen, 1).astype(np.uint8), cv2.DIST_C, 3)[1:-1, 1:-1] * step_px
    rows, columns = np.nonzero(depth >= min(float(depth.max()), 0.8 * max(size_px)))
    middle = np.argwhere(seen).mean(axis=0)
    nearest = int(np.argmin((rows - middle[0]) ** 2 + (columns - middle[1]) ** 2))
    row, column = int(rows[nearest]), int(columns[nearest])
    return (round((column + 0.5) * step_px), round((row + 0.5) * step_px)), float(depth[row, column])


def _placed(
    object_id: int,
    text: str,
    place: tuple[int, int],
    depth_px: float,
    labels: list[Label],
    others: list[tuple[int, int]],
    owners: NDArray[np.int32],
    step_px: int,
    limits: tuple[int, int],
) -> Label:
    width, height = _text_size(text)
    offsets = [(0.0, 0.0)] if depth_px >= 0.5 * max(width, height) else []
    offsets += [(d * np.cos(angle), -d * np.sin(angle)) for d in _DISTANCES_PX for angle in _ANGLES_RAD]
    best, least = None, np.inf
    for dx, dy in offsets:
        x0 = int(np.clip(round(place[0] + dx - width / 2), 0, max(limits[0] - width, 0)))
        y0 = int(np.clip(round(place[1] + dy - height / 2), 0, max(limits[1] - height, 0)))
        box = (x0, y0, x0 + width, y0 + height)
        distance = float(np.hypot(dx, dy))
        if distance >= least:
            break
        below = owners[y0 // step_px : -(-box[3] // step_px), x0 // step_px : -(-box[2] // step_px)]
        covered = float(((below >= 0) & (below != object_id)).mean()) if below.size else 0.0
        num_met = sum(_overlap(box, other.box_px) for other in labels) + sum(_holds(box, other) for other in others)
        cost = distance + _COVERING_PX * covered + 1000.0 * num_met
        if cost < least:
            best, least = box, cost
    assert best is not None
    return Label(object_id=object_id, box_px=best, place_px=place, text=text)


def _text_size(text: str) -> tuple[int, int]:
    import cv2

    (width, height), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _SIZE, _THICKNESS)
    return width + 2 * _PADDING_PX, height + 2 * _PADDING_PX


def _dark(color: tuple[int, int, int]) -> tuple[int, int, int]:
    r, g, b = (int(0.55 * c) for c in color)
    return r, g, b


def draw_title(image: NDArray[np.uint8], text: str) -> None:
    """Draw a title into a strip of a picture."""
    import cv2

    image[:] = (38, 42, 50)
    cv2.putText(image, text, (16, image.shape[0] - 15), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (240, 240, 240), 1, cv2.LINE_AA)


def draw_caption(image: NDArray[np.uint8], text: str) -> None:
    """Draw a line into the upper left corner of a view."""
    import cv2

    cv2.putText(image, text, (12, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (70, 75, 85), 1, cv2.LINE_AA)


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


def _holds(box: tuple[int, int, int, int], place: tuple[int, int]) -> bool:
    return box[0] <= place[0] < box[2] and box[1] <= place[1] < box[3]
