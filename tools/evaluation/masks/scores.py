"""Scores of the masks of one image against its truth: F1 at IoU 0.5 and the best IoU."""
# No mask is right twice. Pixels of unknown truth, and of things too small, do not count; a mask mostly on them, and a
# wrong mask too small to count (as in COCO), is left out.

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

_MIN_SHARE = 0.002
RIGHT_IOU = 0.5
LARGE_SHARE = 0.01
"""Share of the image: larger things must be found."""

UNKNOWN = -1


@dataclass(frozen=True, slots=True)
class MaskScore:
    """Counts over one image or several: true things and masks that count, and the right ones."""

    # `best_iou_sum` is the sum over true things of the IoU with the best mask; `num_large` of the true things are over
    # 1 % of the image, and `large_found` of them have a right mask.
    num_things: int = 0
    num_masks: int = 0
    num_right: int = 0
    best_iou_sum: float = 0.0
    num_large: int = 0
    large_found: int = 0

    @property
    def f1(self) -> float:
        """The harmonic mean of precision and recall of the masks."""
        return 2 * self.num_right / max(self.num_things + self.num_masks, 1)

    @property
    def best_iou(self) -> float:
        """The mean over true things of the IoU with the best mask."""
        return self.best_iou_sum / max(self.num_things, 1)

    @property
    def found_fraction(self) -> float:
        """The share of the things over 1 % of the image that have a right mask."""
        return self.large_found / max(self.num_large, 1)


def score_masks(masks: NDArray[np.int32], truth: NDArray[np.int32], min_pixels: int) -> MaskScore:
    """Return the score of (H, W) masks 1..n against (H, W) truth: 0 = no thing, `UNKNOWN` = not known, else a thing."""
    # Things of fewer than `min_pixels` are too small to count.
    ids, place, pixels = np.unique(truth, return_inverse=True, return_counts=True)
    num_masks = int(masks.max(initial=0))
    shared = np.bincount(
        masks.ravel().astype(np.int64) * len(ids) + place.ravel(), minlength=(num_masks + 1) * len(ids)
    ).reshape(num_masks + 1, len(ids))[1:]
    return score_overlaps(shared, ids, pixels, min_pixels, truth.size)


def score_overlaps(
    shared: NDArray[np.int64], ids: NDArray[Any], pixels: NDArray[np.int64], min_pixels: int, size: int
) -> MaskScore:
    # `pixels` (T,) of the image, which has `size` in all, show each.
    counts = (ids > 0) & (pixels >= min_pixels)
    ignored = (ids == UNKNOWN) | ((ids > 0) & ~counts)
    aside = shared[:, ignored].sum(axis=1)
    area = shared.sum(axis=1) - aside
    union = area[:, None] + pixels[counts][None] - shared[:, counts]
    iou = shared[:, counts] / union
    is_right = iou.max(axis=1, initial=0.0) > RIGHT_IOU
    stays = is_right | ((area >= aside) & (area >= min_pixels))
    best = iou.max(axis=0, initial=0.0)
    large = pixels[counts] > LARGE_SHARE * size
    return MaskScore(
        num_things=int(counts.sum()), num_masks=int(stays.sum()), num_right=int((best > RIGHT_IOU).sum()),
        best_iou_sum=float(best.sum()), num_large=int(large.sum()), large_found=int((large & (best > RIGHT_IOU)).sum()),
    )  # fmt: skip


def total(scores: Iterable[MaskScore]) -> MaskScore:
    every = [dataclasses.astuple(score) for score in scores]
    return MaskScore(*map(sum, zip(*every, strict=True)))


def min_pixels(truth: NDArray[np.int32]) -> int:
    """Return from how many pixels on a thing of an image counts: 0.2 % of it."""
    return int(_MIN_SHARE * truth.size)
