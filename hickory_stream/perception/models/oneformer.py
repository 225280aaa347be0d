"""OneFormer's post-processing: from queries, each with class logits and a mask, to the class of every pixel.

The steps and thresholds are those of the panoptic and semantic post-processing in the library `transformers`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class PanopticConfig(Ranged):
    """How queries become classes.

    Attributes:
        output: `panoptic` gives a pixel to the query with the highest score there, `semantic` to the class with the
            most votes.
        threshold: minimum class probability of a query.
        mask_threshold: minimum probability of a pixel in a query's mask.
        overlap: a query is rejected if other queries leave it less than this share of its mask.
    """

    output: Literal["panoptic", "semantic"] = "panoptic"
    threshold: float = number(0.5, 0, 1, "probability")
    mask_threshold: float = number(0.5, 0, 1, "probability")
    overlap: float = number(0.3, 0, 1, "share")


def panoptic_classes(
    class_logits: NDArray[np.float32],
    mask_logits: NDArray[np.float32],
    size: tuple[int, int],
    config: PanopticConfig,
) -> NDArray[np.int32]:
    """Return (H, W) class ids, -1 for none, from class logits (Q, K + 1) and mask logits (Q, h, w); `size`: (W, H)."""
    probabilities = _softmax(class_logits)
    labels, scores = probabilities.argmax(axis=1), probabilities.max(axis=1)
    # Comparisons with NaN are false: queries that are not finite are rejected.
    chosen = np.flatnonzero((labels != class_logits.shape[1] - 1) & (scores > config.threshold))
    classes = np.full((size[1], size[0]), -1, dtype=np.int32)
    if len(chosen) == 0:
        return classes
    owner = np.zeros(classes.shape, dtype=np.int32)
    best = np.full(classes.shape, -np.inf, dtype=np.float32)
    areas = np.zeros(len(chosen), dtype=np.int64)
    for i, query in enumerate(chosen):
        claim = cv2.resize(_sigmoid(mask_logits[query]), size, interpolation=cv2.INTER_LINEAR) * scores[query]
        areas[i] = np.count_nonzero(claim >= config.mask_threshold)
        wins = claim > best
        owner[wins], best[wins] = i, claim[wins]
    left = np.bincount(owner[np.isfinite(best)], minlength=len(chosen))
    for i, query in enumerate(chosen):
        if left[i] > 0 and areas[i] > 0 and left[i] / areas[i] > config.overlap:
            classes[(owner == i) & np.isfinite(best)] = labels[query]
    return classes


def query_scores(class_logits: NDArray[np.float32], mask_logits: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (K, h, w) the votes of all queries for each class."""
    classes = _softmax(class_logits)[:, :-1]
    num, height, width = mask_logits.shape
    votes = classes.T @ _sigmoid(mask_logits).reshape(num, -1)
    return np.asarray(votes.reshape(-1, height, width), dtype=np.float32)


def _softmax(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(invalid="ignore"):
        powers = np.exp(logits - logits.max(axis=-1, keepdims=True))
        return np.asarray(powers / powers.sum(axis=-1, keepdims=True), dtype=np.float32)


def _sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(1 / (1 + np.exp(-np.clip(logits, -80, 80))), dtype=np.float32)
