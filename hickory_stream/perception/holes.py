"""Holes of depth inside a thing belong to its mask: they are seen, though not measured."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True)
class HoleConfig:
    """Which holes are filled.

    Attributes:
        max_share: larger holes, as a share of the image, are a shadow or the sky.
        own_share: at least this share of a hole's border must be of one mask.
    """

    max_share: float = 0.02
    own_share: float = 0.6


def filled(labels: NDArray[np.int32], has_depth: NDArray[np.bool_], config: HoleConfig) -> NDArray[np.int32]:
    """Return (h, w) labels in which each hole without depth has the label of what surrounds it."""
    count, holes, stats, _ = cv2.connectedComponentsWithStats((~has_depth).astype(np.uint8), connectivity=4)
    if count == 1:
        return labels
    num_labels = int(labels.max()) + 1
    border = np.zeros((count, num_labels), dtype=np.int64)
    for here, there in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        for hole, around in ((here, there), (there, here)):
            meets = (holes[hole] > 0) & has_depth[around]
            key = holes[hole][meets].astype(np.int64) * num_labels + labels[around][meets]
            border += np.bincount(key, minlength=border.size).reshape(border.shape)
    most = border.argmax(axis=1)
    is_own = border[np.arange(count), most] >= config.own_share * np.maximum(border.sum(axis=1), 1)
    is_own &= stats[:, cv2.CC_STAT_AREA] <= config.max_share * labels.size
    fill = np.where(is_own, most, 0).astype(np.int32)
    fill[0] = 0
    return np.where(has_depth, labels, fill[holes])
