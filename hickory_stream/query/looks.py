"""Likeness of a map's objects to a text, by an image-text network on their best views.

Relevancy of Kerr et al. (LERF, ICCV 2023) against neutral texts, with the temperature of 100 (Radford et al., 2021);
0.5 is as near as a neutral text. Features are cached by the hashes of view and network.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.base.atomic_files import write_atomically
from hickory_stream.base.caches import cache_folder, mark_used
from hickory_stream.map_folder.views import crop_files, read_crop

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    from hickory_stream.map_folder.saved_map import SavedMap
    from hickory_stream.perception.models.image_text import ImageTextNetwork
    from hickory_stream.query.map_index import MapIndex

_PROMPT = "a photo of a {}."
_SAYS_NOTHING = ("object", "thing", "stuff", "texture")
_SCALE = 100.0


class ObjectLooks:
    """Likeness of each object of an index to a text; features are computed on first use.

    `network_hash` is of the files that a feature depends on; `progress` gets the number of finished and of all views.
    """

    def __init__(
        self,
        saved: SavedMap,
        index: MapIndex,
        network: ImageTextNetwork,
        network_hash: str,
        progress: Callable[[int, int], None] = lambda _done, _total: None,
    ) -> None:
        self._saved = saved
        self._ids = index.ids.tolist()
        self._network = network
        self._network_hash = network_hash
        self._progress = progress
        self._features: NDArray[np.float32] | None = None

    def __call__(self, text: str) -> NDArray[np.float64]:
        """Return (N,) degrees in 0..1, 0 for an object without a view; raises `MapFolderError` or `ModelError`."""
        if self._features is None:
            self._features = self._of_views()
        asked = self._features @ self._network.of_text(_PROMPT.format(text))
        empty = [self._features @ self._network.of_text(_PROMPT.format(word)) for word in _SAYS_NOTHING]
        ahead = _SCALE * (asked - np.max(empty, axis=0)).astype(np.float64)
        return np.where(self._features.any(axis=1), 1.0 / (1.0 + np.exp(-ahead)), 0.0)

    def _of_views(self) -> NDArray[np.float32]:
        """Return (N, D) features of unit norm, zero where there is no view."""
        views = {item.id: item.best_view for item in self._saved.snapshot.objects}
        dim = len(self._network.of_text(_PROMPT.format(_SAYS_NOTHING[0])))
        features = np.zeros((len(self._ids), dim), np.float32)
        for i, object_id in enumerate(self._ids):
            view = views[object_id]
            if view is not None:
                features[i] = self._of_view(view.name, dim)
            self._progress(i + 1, len(self._ids))
        return features

    def _of_view(self, name: str, dim: int) -> NDArray[np.float32]:
        # Checks the files, which the hash below alone would not.
        rgb = read_crop(self._saved.views, name).rgb
        color_file = crop_files(self._saved.views, name)[0]
        key = hashlib.sha256(self._network_hash.encode() + color_file.read_bytes()).hexdigest()
        path = cache_folder("image-features") / key[:2] / f"{key}.f32"
        kept = _kept(path, dim)
        if kept is None:
            kept = self._network.of_image(squared(rgb))
            _keep(path, kept)
        return kept


def squared(rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return a picture with borders of its mean colour to a square: networks use the middle square."""
    height, width = rgb.shape[:2]
    side = max(height, width)
    top, left = (side - height) // 2, (side - width) // 2
    mean = [round(float(value)) for value in rgb.reshape(-1, 3).mean(axis=0)]
    return np.asarray(
        cv2.copyMakeBorder(
            np.ascontiguousarray(rgb), top, side - height - top, left, side - width - left, cv2.BORDER_CONSTANT,
            value=mean,
        )
    )  # fmt: skip


def _kept(path: Path, dim: int) -> NDArray[np.float32] | None:
    try:
        feature = np.frombuffer(path.read_bytes(), "<f4").astype(np.float32)
    except (OSError, ValueError):
        return None
    if len(feature) != dim or not abs(float(np.linalg.norm(feature)) - 1) < 1e-3:
        return None
    mark_used(path)
    return feature


def _keep(path: Path, feature: NDArray[np.float32]) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, feature.astype("<f4").tobytes(), sync=False)
    except OSError:  # it is a cache: a full disk is no reason not to answer
        path.unlink(missing_ok=True)
