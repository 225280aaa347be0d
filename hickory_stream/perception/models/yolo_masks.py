"""Masks of the image from the tensors of a YOLOv8-seg graph: pure functions, no network.

A mask is the sum of the prototypes weighted by a detection's coefficients, interpolated bilinearly inside its box.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.models.preprocessing import Letterbox

# Boxes are offset by this distance per class, so that boxes of different classes never suppress each other.
_CLASS_OFFSET_PX = 7680.0
_MAX_CANDIDATES = 30_000


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Detections:
    """The detections that passed the thresholds, the best first; coefficients are (N, C)."""

    #: (N, 4) x0, y0, x1, y1 in the network's frame
    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    classes: NDArray[np.int64]
    coefficients: NDArray[np.float32]
    #: number of detections with NaN or infinity
    num_not_finite: int


def detections_of(
    predictions: NDArray[np.float32],
    num_coefficients: int,
    *,
    confidence: float,
    nms_iou: float,
    max_masks: int,
) -> Detections:
    """Return the detections of (4 + classes + coefficients, anchors): x, y, w, h, scores, coefficients."""
    # The best class of each anchor counts; non-maximum suppression is per class.
    num_classes = len(predictions) - 4 - num_coefficients
    scores = predictions[4 : 4 + num_classes]
    best = scores.max(axis=0)
    is_finite = np.isfinite(predictions).all(axis=0) if not np.isfinite(predictions.sum()) else None
    chosen = np.flatnonzero(best > confidence if is_finite is None else is_finite & (best > confidence))
    chosen = chosen[np.argsort(-best[chosen], kind="stable")][:_MAX_CANDIDATES]
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
    """Return the indices of at most `most` boxes (N, 4), sorted best first, that survive non-maximum suppression."""
    return np.asarray(_suppress(np.ascontiguousarray(boxes), np.float32(iou), most))


@kernel
def _suppress(boxes, iou, most):
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
    """Return the masks of detections whose `boxes` (N, 4) are in the image; some may be empty.

    `prototypes` (C, h, w) cover the network's frame; their weighted sum is above 0 in the mask.
    """
    num, height, width = prototypes.shape
    rows = _taps(letterbox.height, letterbox.inner_height, letterbox.top, letterbox.frame_height, height, letterbox)
    columns = _taps(letterbox.width, letterbox.inner_width, letterbox.left, letterbox.frame_width, width, letterbox)
    sums = (coefficients @ prototypes.reshape(num, -1)).reshape(-1, height, width)
    masks = []
    for box, score, total in zip(boxes, scores, sums, strict=True):
        x0, y0 = (max(0, int(np.ceil(v))) for v in box[:2])
        x1, y1 = min(letterbox.width, int(np.ceil(box[2]))), min(letterbox.height, int(np.ceil(box[3])))
        x1, y1 = max(x1, x0), max(y1, y0)
        mask = np.empty((y1 - y0, x1 - x0), dtype=np.bool_)
        if mask.size:
            _read(total, rows.at[y0:y1], rows.weights[y0:y1], columns.at[x0:x1], columns.weights[x0:x1], mask)
        masks.append(InstanceMask(box_px=(x0, y0, x1, y1), mask=mask, score=float(score)))
    return masks


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Taps:
    """Interpolation along one axis: each pixel uses three cells from index `at` (N,), by `weights` (N, 3)."""

    at: NDArray[np.int64]
    weights: NDArray[np.float32]


def taps_along(length: int, *, size: int, factor: int, first: int, count: int) -> Taps:
    """Return the taps of two bilinear resizes in a row, which use three cells together.

    `size` cells are enlarged by an integer `factor`; `count` pixels of these from `first` on are resized to `length`.
    """
    place = np.clip((np.arange(length) + 0.5) * count / length - 0.5, 0, count - 1)
    lower = place.astype(np.int64)
    upper = np.minimum(lower + 1, count - 1)
    at, weights = np.zeros(length, dtype=np.int64), np.zeros((length, 3), dtype=np.float32)
    for stretched, share in ((lower, 1 - (place - lower)), (upper, place - lower)):
        cell = np.clip((first + stretched + 0.5) / factor - 0.5, 0, size - 1)
        left = cell.astype(np.int64)
        if stretched is lower:
            at = np.clip(left, 0, max(size - 3, 0))
        for tap, part in ((left, 1 - (cell - left)), (np.minimum(left + 1, size - 1), cell - left)):
            np.add.at(weights, (np.arange(length), tap - at), share * part)
    return Taps(at=at, weights=weights)


def _taps(length: int, inner: int, start: int, frame: int, size: int, letterbox: Letterbox) -> Taps:
    # The reference enlarges the prototypes by an integer factor, after which it crops the grey border at a whole pixel.
    ratio = max(1, frame // size)
    grey = (letterbox.frame_height - letterbox.inner_height) | (letterbox.frame_width - letterbox.inner_width)
    factor = ratio // math.gcd(ratio, grey | grey // 2)
    per_frame = factor * size / frame
    first, count = round(start * per_frame), max(1, round(inner * per_frame))
    return taps_along(length, size=size, factor=factor, first=first, count=count)


@kernel
def _read(values, rows, row_weights, columns, column_weights, out):
    # Whether values (h, w), interpolated from three rows and three columns per pixel, are above 0.
    height, width = values.shape
    line = np.zeros(max(width, 3), dtype=np.float32)
    for y in range(len(rows)):
        for x in range(columns[0], min(columns[-1] + 3, width)):
            line[x] = 0
            for k in range(min(3, height)):
                line[x] += row_weights[y, k] * values[rows[y] + k, x]
        for x in range(len(columns)):
            i = columns[x]
            total = column_weights[x, 0] * line[i]
            total += column_weights[x, 1] * line[i + 1] + column_weights[x, 2] * line[i + 2]
            out[y, x] = total > 0
