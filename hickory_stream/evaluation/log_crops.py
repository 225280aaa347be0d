"""Pictures of true objects, cut out of the keyframe images in a map's journal."""

from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.truth import Truth, frame_at, instances_of
from hickory_stream.journal.reader import Journal
from hickory_stream.journal.step import Step, StepKind

_MARGIN = 0.6
_LEAST_MARGIN_PX = 12


def pictures_of(path: Path, truth: Truth, frames: Mapping[int, int]) -> dict[int, NDArray[np.uint8]]:
    """Return a picture (h, w, 3) of each true object, dimmed outside the object, from the keyframe in `frames`.

    Objects whose keyframe has no image in the journal, or does not show them, are left out. Raises `MapFolderError` for
    the journal, `RecordingError` for an image of the truth.
    """
    stamps = np.array([frame.stamp_ns for frame in truth.frames], dtype=np.int64)
    pictures: dict[int, NDArray[np.uint8]] = {}
    with Journal(path) as journal:
        steps = {step.frames[-1].index: i for i, step in _keyframe_steps(journal)}
        for truth_id, frame in frames.items():
            index = steps.get(frame)
            color = journal.color(index) if index is not None else None
            at = frame_at(stamps, int(journal.stamps_ns[index])) if index is not None else None
            if color is None or at is None:
                continue
            image = cv2.imdecode(np.frombuffer(color, np.uint8), cv2.IMREAD_COLOR)
            mask = instances_of(truth, truth.frames[at]) == truth_id
            if image is not None and image.shape[:2] == mask.shape and mask.any():
                pictures[truth_id] = _cut_out(np.asarray(image[..., ::-1], dtype=np.uint8), mask)
    return pictures


def _keyframe_steps(journal: Journal) -> list[tuple[int, Step]]:
    steps = ((i, journal.step(i)) for i in range(len(journal)))
    return [(i, step) for i, step in steps if step.kind is StepKind.KEYFRAME and step.frames]


def _cut_out(rgb: NDArray[np.uint8], mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    rows, columns = np.nonzero(mask)
    height, width = mask.shape
    half = int(max(np.ptp(rows), np.ptp(columns)) / 2 * (1 + _MARGIN)) + _LEAST_MARGIN_PX
    row, column = int(rows.min() + rows.max()) // 2, int(columns.min() + columns.max()) // 2
    window = slice(max(0, row - half), min(height, row + half)), slice(max(0, column - half), min(width, column + half))
    part, inside = rgb[window], mask[window]
    dimmed = np.where(inside[..., None], part, 0.5 * part + 0.5 * 200).astype(np.uint8)
    scale = max(1, 200 // max(part.shape[:2]))
    size = (part.shape[1] * scale, part.shape[0] * scale)
    return np.asarray(cv2.resize(dimmed, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)
