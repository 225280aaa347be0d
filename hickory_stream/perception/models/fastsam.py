"""FastSAM: class-agnostic instance masks by any YOLOv8-seg style graph, of one class or more.

The graph takes (1, 3, S, S) colour in 0..1 and gives predictions (1, 4 + classes + C, anchors) and prototypes
(1, C, h, w).
"""

import logging
from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.models.network import Network
from hickory_stream.perception.models.preprocessing import letterbox_of, letterboxed
from hickory_stream.perception.models.yolo_masks import detections_of, masks_of
from hickory_stream.perception.network_segmenter import NetworkSegmenter
from hickory_stream.ports import shared_by
from hickory_stream.records import Frame, MapPrior, RejectedMask, Segmentation

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True, slots=True)
class FastSamConfig(Ranged):
    """How masks are decoded from the network's output."""

    #: Name of the network in the folder of models.
    model: str = "fastsam-s"
    #: Minimum score of a detection.
    confidence: float = number(0.4, 0, 1, "probability")
    #: IoU of boxes above which non-maximum suppression removes the one with the lower score.
    nms_iou: float = number(0.9, 0, 1, "IoU")
    #: Maximum number of masks, the best ones.
    max_masks: int = number(300, 1, 100_000, "masks")
    #: Side of the network's input image if the graph does not fix it.
    input_px: int = number(640, 32, 8192, "px")
    #: Longer side of the image at which masks are decoded; 0: the frame's.
    mask_px: int = number(0, 0, 8192, "px")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Found:
    """The results of a frame that need no map: the base segmenter's, masks, and the number of non-finite detections."""

    base: object
    masks: list[InstanceMask]
    num_not_finite: int


class FastSam:
    """The network without the mask pipeline: from an image to masks that may overlap; raises `ModelError`."""

    def __init__(self, network: Network, config: FastSamConfig, *, warm_up: bool = True) -> None:
        self._network = network
        self._config = config
        height, width = network.require_image_input("YOLOv8-seg")
        self._size = (width or config.input_px, height or config.input_px)
        self._predictions, self._prototypes = _outputs_of(network)
        if warm_up:
            network.warm_up(np.zeros((1, 3, self._size[1], self._size[0]), dtype=np.float32))

    def share_runs(self) -> int:
        """Let images of several threads share runs; return how many share one."""
        return self._network.share_runs()

    def masks(self, rgb: NDArray[np.uint8]) -> tuple[list[InstanceMask], int]:
        """Return the masks of an image (H, W, 3), best first, and the number of non-finite detections."""
        height, width, _ = rgb.shape
        letterbox = letterbox_of(width, height, *self._size)
        outputs = self._network.run(letterboxed(rgb, letterbox))
        return self.decode(outputs[self._predictions], outputs[self._prototypes], width, height)

    def decode(
        self, predictions: NDArray[np.float32], prototypes: NDArray[np.float32], width: int, height: int
    ) -> tuple[list[InstanceMask], int]:
        """Return the masks in an image of this size, and the number of non-finite detections, from the two tensors."""
        config = self._config
        if predictions.shape[1] < 5 + prototypes.shape[1]:
            raise self._network.mismatch(
                "YOLOv8-seg", f"4 + classes + {prototypes.shape[1]} rows in its predictions, as it has prototypes"
            )
        found = detections_of(
            predictions[0],
            prototypes.shape[1],
            confidence=config.confidence,
            nms_iou=config.nms_iou,
            max_masks=config.max_masks,
        )
        letterbox = letterbox_of(width, height, *self._size)
        scale = min(1.0, config.mask_px / max(width, height)) if config.mask_px else 1.0
        if scale < 1.0:
            letterbox = letterbox_of(max(1, round(width * scale)), max(1, round(height * scale)), *self._size)
        boxes = letterbox.to_image(found.boxes)
        masks = masks_of(boxes, found.scores, found.coefficients, prototypes[0], letterbox)
        if scale < 1.0:
            masks = [_stretched(mask, letterbox.width, letterbox.height, width, height) for mask in masks]
        return masks, found.num_not_finite


class MaskNetwork(Protocol):
    """A network that gives masks which may overlap."""

    def masks(self, rgb: NDArray[np.uint8]) -> tuple[list[InstanceMask], int]:
        """Return the masks of an image (H, W, 3), best first, and how many are not finite; raises `ModelError`."""


class FastSamSegmenter:
    """A `Segmenter`: masks of FastSAM or another network are evidence for joining fragments of a base segmenter."""

    def __init__(self, network: MaskNetwork, base: NetworkSegmenter) -> None:
        self._network, self._base = network, base
        self._has_warned = False

    def share_runs(self) -> int:
        """Let frames of several threads share runs of the network; return how many share one."""
        return shared_by(self._network)

    def prepare(self, frame: Frame) -> Found:
        """Return the fragments' inputs and the masks of a frame; raises `ModelError`."""
        masks, num_not_finite = self._network.masks(np.asarray(frame.rgb))
        if num_not_finite and not self._has_warned:
            self._has_warned = True
            text = "the network gave %d detections with NaN or infinity in frame %d; they are left out (said once)"
            logger.warning(text, num_not_finite, frame.index)
        return Found(base=self._base.prepare(frame), masks=masks, num_not_finite=num_not_finite)

    def moved(self, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
        """Return the result of `prepare` for another pose (4, 4) of the frame; masks do not depend on it."""
        if not isinstance(prepared, Found):
            return None
        return replace(prepared, base=self._base.moved(prepared.base, world_from_camera))

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prior` is the map so far."""
        found = prepared if isinstance(prepared, Found) else self.prepare(frame)
        segmentation = self._base.segment_with(found.masks, frame, prior, found.base)
        if not found.num_not_finite:
            return segmentation
        reason = f"{found.num_not_finite} detections of the network are not finite"
        not_finite = RejectedMask(box_px=(0, 0, frame.camera.width, frame.camera.height), reason=reason)
        return replace(segmentation, rejected=(*segmentation.rejected, not_finite))


def _outputs_of(network: Network) -> tuple[int, int]:
    # The indices of the predictions and the prototypes among the outputs, identified by their ranks.
    ranks = [len(output.shape) for output in network.outputs]
    if ranks.count(3) != 1 or ranks.count(4) != 1:
        expected = "predictions (1, 4 + classes + C, anchors) and prototypes (1, C, h, w) as its outputs"
        raise network.mismatch("YOLOv8-seg", expected)
    predictions, prototypes = ranks.index(3), ranks.index(4)
    rows, channels = network.outputs[predictions].shape[1], network.outputs[prototypes].shape[1]
    if rows is not None and channels is not None and rows < 5 + channels:
        raise network.mismatch("YOLOv8-seg", f"4 + classes + {channels} rows in its predictions, as it has prototypes")
    return predictions, prototypes


def _stretched(mask: InstanceMask, width: int, height: int, full_width: int, full_height: int) -> InstanceMask:
    x0, y0, x1, y1 = mask.box_px
    u0, u1 = (round(x * full_width / width) for x in (x0, x1))
    v0, v1 = (round(y * full_height / height) for y in (y0, y1))
    if mask.mask.size == 0 or u1 <= u0 or v1 <= v0:
        return InstanceMask(box_px=(u0, v0, u0, v0), mask=np.zeros((0, 0), dtype=bool), score=mask.score)
    large = cv2.resize(mask.mask.astype(np.uint8), (u1 - u0, v1 - v0), interpolation=cv2.INTER_NEAREST) > 0
    return InstanceMask(box_px=(u0, v0, u1, v1), mask=large, score=mask.score)
