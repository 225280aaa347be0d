"""How much two objects look alike, wherever they are: by the sides of their boxes, their colour and their feature."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.changes.records import ChangesConfig
    from hickory_stream.records import TrackedObject

# Cosines of pooled features: of unrelated objects, and of one object in two maps.
_COSINE = (0.3, 0.7)


def likeness(
    a: TrackedObject, b: TrackedObject, config: ChangesConfig, *, with_size: bool, with_feature: bool
) -> float:
    """Return how far two objects look alike, in 0..1; what one of them lacks does not count.

    `with_size` is False for objects in one place: of which one map may have seen less. `with_feature` is False where
    the two maps' features were made by different networks.
    """
    away = (np.linalg.norm(_lab(a) - _lab(b)) / config.color_sigma) ** 2
    if with_size:
        away += (np.abs(np.log(_sides(a) / _sides(b))).max() / config.size_sigma) ** 2
    alike = float(np.exp(-0.5 * away))
    if with_feature and a.feature is not None and b.feature is not None and a.feature.shape == b.feature.shape:
        alike *= float(np.clip((float(a.feature @ b.feature) - _COSINE[0]) / (_COSINE[1] - _COSINE[0]), 0.05, 1.0))
    return alike


def probability_same(alike: float, floor: float) -> float:
    """Return how probable it is that two objects are one, from their likeness and that of any two objects."""
    return alike / (alike + floor)


def _sides(item: TrackedObject) -> NDArray[np.float64]:
    half = item.box.half_extents_m
    return np.array([*np.sort(half[:2]), half[2]])


def _lab(item: TrackedObject) -> NDArray[np.float64]:
    if not len(item.colors):
        return np.zeros(3)
    middle = np.median(item.colors, axis=0).astype(np.float32)[None, None] / np.float32(255)
    return np.asarray(cv2.cvtColor(middle, cv2.COLOR_RGB2LAB)[0, 0], dtype=np.float64)
