"""A semantic model from an ONNX graph that gives class scores per pixel, class ids, or the queries of OneFormer.

Ranks distinguish the three kinds of output. Steps and thresholds of queries are those of the library `transformers`.
"""

from dataclasses import dataclass, field
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ModelError
from hickory_stream.perception.models.network import Network
from hickory_stream.perception.models.preprocessing import normalised
from hickory_stream.perception.semantic_filter import FilterConfig
from hickory_stream.records import SemanticImage

# Minimum probability of a pixel in a query's mask.
MASK_THRESHOLD = 0.5
# A query is rejected if other queries leave it less than this share of its mask.
MIN_OVERLAP = 0.3


@dataclass(frozen=True, kw_only=True, slots=True)
class PanopticConfig(Ranged):
    """How queries become classes."""

    #: `panoptic`: a pixel goes to the query with the highest score there; `semantic`: to the class with the most votes.
    output: Literal["panoptic", "semantic"] = "panoptic"
    #: Minimum class probability of a query.
    threshold: float = number(0.5, 0, 1, "probability")


def panoptic_classes(
    class_logits: NDArray[np.float32], mask_logits: NDArray[np.float32], size: tuple[int, int], config: PanopticConfig
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
        areas[i] = np.count_nonzero(claim >= MASK_THRESHOLD)
        wins = claim > best
        owner[wins], best[wins] = i, claim[wins]
    left = np.bincount(owner[np.isfinite(best)], minlength=len(chosen))
    for i, query in enumerate(chosen):
        if left[i] > 0 and areas[i] > 0 and left[i] / areas[i] > MIN_OVERLAP:
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


_MULTIPLE = 32


@dataclass(frozen=True, kw_only=True, slots=True)
class SemanticConfig(Ranged):
    """Which semantic model is used, and at which size."""

    #: Name of the network in the folder of models.
    model: str = "oneformer-ade20k-swin-tiny"
    #: Shorter side of the network's input image if the graph does not fix it.
    short_px: int = number(512, 32, 8192, "px")
    panoptic: PanopticConfig = field(default_factory=PanopticConfig)
    exclude: FilterConfig = field(default_factory=FilterConfig)


class GraphSemantics:
    """A `SemanticModel`; `labels` are the names of the K classes.

    The graph takes (1, 3, H, W), normalised as for ImageNet, and gives class scores (1, K, h, w), class ids
    (1, h, w), or class and mask logits of queries, (1, Q, K + 1) and (1, Q, h, w).

    Raises:
        ModelError: the graph is of another kind, or has another number of classes.
    """

    def __init__(
        self,
        network: Network,
        labels: tuple[str, ...],
        *,
        short_px: int,
        panoptic: PanopticConfig,
        warm_up: bool = True,
    ) -> None:
        self._network, self._labels, self._short_px, self._panoptic = network, labels, short_px, panoptic
        self._fixed = network.require_image_input("semantic")
        ranks = sorted(len(output.shape) for output in network.outputs)
        if ranks not in ([3], [4], [3, 4]):
            expected = "class scores (1, K, h, w), class ids (1, h, w), or logits (1, Q, K + 1) and masks (1, Q, h, w)"
            raise network.mismatch("semantic", expected)
        shapes = {len(output.shape): output.shape for output in network.outputs}
        classes = shapes[3][2] if len(ranks) == 2 else shapes[4][1] if 4 in shapes else None
        if classes is not None:
            self._check(classes - (len(ranks) == 2))
        if warm_up:
            side = -(-short_px // _MULTIPLE) * _MULTIPLE
            network.warm_up(np.zeros((1, 3, self._fixed[0] or side, self._fixed[1] or side), dtype=np.float32))

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of the classes, by their ids."""
        return self._labels

    def share_runs(self) -> int:
        """Let images of several threads share runs; return how many share one."""
        return self._network.share_runs()

    def classify(self, rgb: NDArray[np.uint8]) -> SemanticImage:
        """Return the class of every pixel of an image (H, W, 3); raises `ModelError`."""
        size = (rgb.shape[1], rgb.shape[0])
        outputs = self._network.run(normalised(self._resized(rgb)))
        by_rank = {output.ndim: output[0] for output in outputs}
        if len(by_rank) == 2:
            self._check(by_rank[3].shape[1] - 1)
            if self._panoptic.output == "semantic":
                classes = best_classes(query_scores(by_rank[3], by_rank[4]), size)
            else:
                classes = panoptic_classes(by_rank[3], by_rank[4], size, self._panoptic)
        elif 4 in by_rank:
            self._check(by_rank[4].shape[0])
            classes = best_classes(by_rank[4], size)
        else:
            ids = np.maximum(np.nan_to_num(by_rank[3], nan=-1), -1).astype(np.int32)
            self._check(max(int(ids.max()) + 1, len(self._labels)))
            classes = cv2.resize(ids.astype(np.float32), size, interpolation=cv2.INTER_NEAREST).astype(np.int32)
        return SemanticImage(classes=classes, labels=self._labels)

    def _check(self, num_classes: int) -> None:
        if num_classes != len(self._labels):
            raise ModelError(
                f"{self._network.path} has {num_classes} classes, the manifest names {len(self._labels)}; give it the "
                "right table with `hickory-stream models add --labels FILE`"
            )

    def _resized(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        height, width = rgb.shape[:2]
        scale = self._short_px / min(height, width)
        # Multiples of 32: backbones halve their image five times.
        wanted = [max(_MULTIPLE, round(n * scale / _MULTIPLE) * _MULTIPLE) for n in (height, width)]
        target = (self._fixed[1] or wanted[1], self._fixed[0] or wanted[0])
        if target == (width, height):
            return rgb
        is_smaller = target[0] < width or target[1] < height
        return cv2.resize(rgb, target, interpolation=cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR)


def best_classes(scores: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.int32]:
    """Return (H, W) the class with the highest of (K, h, w) scores, interpolated; never NaN's; `size` is (W, H)."""
    classes = np.full((size[1], size[0]), -1, dtype=np.int32)
    best = np.full(classes.shape, -np.inf, dtype=np.float32)
    for i, plane in enumerate(scores):
        # One class at a time: 150 of them at the size of the frame would take 180 MB.
        large = cv2.resize(np.ascontiguousarray(plane), size, interpolation=cv2.INTER_LINEAR)
        wins = large > best
        classes[wins], best[wins] = i, large[wins]
    return classes
