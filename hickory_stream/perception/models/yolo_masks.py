"""From the tensors of a YOLOv8-seg graph to masks of the image: pure functions, no network.

A detection is a box, a score per class and 32 coefficients; a mask is the coefficients' sum of the prototypes, read
bilinearly where it is needed, cut at its box. Only the pixels of its box are ever computed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numba
import numpy as np

from hickory_stream.perception.masks import InstanceMask

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.models.letterbox import Letterbox

# Boxes of different classes never suppress one another when they are this far apart.
_CLASS_OFFSET_PX = 7680.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Detections:
    """What passed the thresholds, the best first.

    `boxes` (N, 4) x0, y0, x1, y1 in the network's frame, `scores` (N,), `classes` (N,), `coefficients` (N, C);
    `num_not_finite` detections had NaN or infinity in them.
    """

    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    classes: NDArray[np.int64]
    coefficients: NDArray[np.float32]
    num_not_finite: int


def detections_of(
    predictions: NDArray[np.float32],
    num_coefficients: int,
    *,
    confidence: float,
    nms_iou: float,
    max_masks: int,
    max_candidates: int = 30000,
) -> Detections:
    """Return the detections of `predictions` (4 + classes + coefficients, anchors): x, y, w, h, scores, coefficients.

    Thresholds on the best class of each anchor, then suppresses what overlaps a better one of its class.
    """
    num_classes = len(predictions) - 4 - num_coefficients
    scores = predictions[4 : 4 + num_classes]
    best = scores.max(axis=0)
    is_finite = np.isfinite(predictions).all(axis=0) if not np.isfinite(predictions.sum()) else None
    chosen = np.flatnonzero(best > confidence if is_finite is None else is_finite & (best > confidence))
    chosen = chosen[np.argsort(-best[chosen], kind="stable")][:max_candidates]
    x, y, width, height = predictions[:4, chosen]
    boxes = np.stack([x - width / 2, y - height / 2, x + width / 2, y + height / 2], axis=1)
    classes = scores[:, chosen].argmax(axis=0)
    shifted = boxes + (classes * np.float32(_CLASS_OFFSET_PX))[:, None]
    kept = suppressed(shifted.astype(np.float32), nms_iou, max_masks)
    return Detections(
        boxes=boxes[kept],
        scores=best[chosen][kept],
        classes=classes[kept],
        coefficients=np.ascontiguousarray(predictions[4 + num_classes :, chosen[kept]].T),
        num_not_finite=0 if is_finite is None else int(np.count_nonzero(~is_finite)),
    )


def suppressed(boxes: NDArray[np.float32], iou: float, most: int) -> NDArray[np.int64]:
    """Return the places of the boxes (N, 4), sorted best first, that no better kept one overlaps by more than `iou`."""
    kept: NDArray[np.int64] = _suppress(np.ascontiguousarray(boxes), np.float32(iou), most)
    return kept


@numba.njit(cache=True, nogil=True)
def _suppress(boxes, iou, most):  # type: ignore[no-untyped-def] # pragma: no cover
    kept = np.empty(min(most, len(boxes)), dtype=np.int64)
    count = 0
    for i in range(len(boxes)):
        if count == most:
            break
        area = (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1])
        is_free = True
        for k in range(count):
            j = kept[k]
            width = min(boxes[i, 2], boxes[j, 2]) - max(boxes[i, 0], boxes[j, 0])
            height = min(boxes[i, 3], boxes[j, 3]) - max(boxes[i, 1], boxes[j, 1])
            if width <= 0 or height <= 0:
                continue
            shared = width * height
            other = (boxes[j, 2] - boxes[j, 0]) * (boxes[j, 3] - boxes[j, 1])
            if shared > iou * (area + other - shared):
                is_free = False
                break
        if is_free:
            kept[count] = i
            count += 1
    return kept[:count]


def masks_of(
    boxes: NDArray[np.float32],
    scores: NDArray[np.float32],
    coefficients: NDArray[np.float32],
    prototypes: NDArray[np.float32],
    letterbox: Letterbox,
) -> list[InstanceMask]:
    """Return the masks of detections whose `boxes` (N, 4) are in the image.

    `prototypes` (C, h, w) cover the network's frame; the mask is where their sum, read bilinearly, is above 0. One
    without a pixel comes as an empty mask.
    """
    num, height, width = prototypes.shape
    # Where the image lies on the prototypes: top, height, left, width; not always on whole ones.
    per_row, per_column = height / letterbox.frame_height, width / letterbox.frame_width
    place = np.array(
        [
            letterbox.top * per_row,
            letterbox.inner_height * per_row,
            letterbox.left * per_column,
            letterbox.inner_width * per_column,
        ],
        dtype=np.float32,
    )
    sums = (coefficients @ prototypes.reshape(num, -1)).reshape(-1, height, width)
    masks = []
    for box, score, total in zip(boxes, scores, sums, strict=True):
        x0, y0 = (max(0, int(np.ceil(v))) for v in box[:2])
        x1, y1 = min(letterbox.width, int(np.ceil(box[2]))), min(letterbox.height, int(np.ceil(box[3])))
        x1, y1 = max(x1, x0), max(y1, y0)
        mask = np.empty((y1 - y0, x1 - x0), dtype=np.bool_)
        _read_bilinearly(total, place, letterbox.height, letterbox.width, y0, x0, mask)
        masks.append(InstanceMask(box_px=(x0, y0, x1, y1), mask=mask, score=float(score)))
    return masks


@numba.njit(cache=True, nogil=True)
def _read_bilinearly(values, place, height, width, y0, x0, out):  # type: ignore[no-untyped-def] # pragma: no cover
    """Whether values, of which the part at `place` covers an image (height, width), are above 0 from (y0, x0) on."""
    if out.size == 0:
        return
    rows, columns = values.shape
    left, right, right_share = _places(x0, out.shape[1], width, place[2], place[3], columns)
    upper, lower, lower_share = _places(y0, out.shape[0], height, place[0], place[1], rows)
    line = np.empty(columns, dtype=np.float32)
    for y in range(out.shape[0]):
        i, j, down = upper[y], lower[y], lower_share[y]
        for x in range(left[0], right[-1] + 1):
            line[x] = values[i, x] + down * (values[j, x] - values[i, x])
        for x in range(out.shape[1]):
            here = line[left[x]]
            out[y, x] = here + right_share[x] * (line[right[x]] - here) > 0


@numba.njit(cache=True, nogil=True)
def _places(first, count, length, start, extent, size):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the two values that each pixel lies between, and the share of the second one; the ends are held."""
    before, after = np.empty(count, dtype=np.int64), np.empty(count, dtype=np.int64)
    share = np.empty(count, dtype=np.float32)
    lowest = max(start, np.float32(0.0))
    highest = max(lowest, min(start + extent, np.float32(size)) - np.float32(1.0))
    scale = extent / np.float32(length)
    for k in range(count):
        at = start + (np.float32(first + k) + np.float32(0.5)) * scale - np.float32(0.5)
        at = min(max(at, lowest), highest)
        before[k] = int(at)
        after[k] = min(before[k] + 1, size - 1)
        share[k] = at - np.float32(before[k])
    return before, after, share
