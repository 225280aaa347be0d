"""Time of FastSAM without the network itself: part of `tools/bench perception`."""

from types import SimpleNamespace

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.choose import make_segmenter
from hickory_stream.perception.models.fastsam import FastSam, FastSamConfig
from hickory_stream.perception.models.network import Tensor
from hickory_stream.perception.models.preprocessing import letterbox_of, letterboxed
from hickory_stream.perception.network_segmenter import NetworkSegmenter
from hickory_stream.perception.perceive import PerceptionConfig
from hickory_stream.records import Frame
from tools.benchmarks.common.figures import Figure, figure
from tools.benchmarks.common.processes import best_s

_WIDTH, _HEIGHT, _SIDE, _PROTO, _CHANNELS, _ANCHORS, _MASKS = 640, 480, 640, 160, 32, 8400, 100
_REPEATS = 30


def network_times(seed: int) -> list[Figure]:
    """Return the times of decoding a network's outputs and of the pipeline for its masks, on one core."""
    # First: letterbox, decoding, suppression, 100 masks at 640 x 480. Second: the work that all segmenters share.
    # Processor time, the least of the repeats.
    rng = np.random.default_rng(seed)
    predictions, prototypes = _tensors(rng)
    rgb = rng.integers(0, 255, (_HEIGHT, _WIDTH, 3), np.uint8)
    fastsam = FastSam(_network(), FastSamConfig(max_masks=_MASKS), warm_up=False)  # type: ignore[arg-type]
    masks, _not_finite = fastsam.decode(predictions, prototypes, _WIDTH, _HEIGHT)
    assert len(masks) == _MASKS, f"{len(masks)} masks, expected {_MASKS}"

    def prepost() -> None:
        letterboxed(rgb, letterbox_of(_WIDTH, _HEIGHT, _SIDE, _SIDE))
        fastsam.decode(predictions, prototypes, _WIDTH, _HEIGHT)

    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        prepost_ms = 1e3 * best_s(prepost, _REPEATS)
    finally:
        cv2.setNumThreads(threads)
    frame, base = _wall(), make_segmenter(PerceptionConfig())
    assert isinstance(base, NetworkSegmenter)
    ready = base.prepare(frame)
    least_s = [best_s(lambda own=own: base.segment_with(own, frame, None, ready), _REPEATS // 2) for own in (masks, [])]
    pipeline_ms = 1e3 * (least_s[0] - least_s[1])
    times = {"fastsam_prepost_ms": prepost_ms, "mask_pipeline_ms": pipeline_ms}
    return [figure(name, ms, "ms", "lower") for name, ms in times.items()]


def _wall() -> Frame:
    depth = np.full((_HEIGHT, _WIDTH), 2.0, dtype=np.float32)
    depth[:, _WIDTH // 2 :] = 1.8
    return Frame(
        index=0, stamp_ns=0, rgb=np.zeros((_HEIGHT, _WIDTH, 3), np.uint8), depth_m=depth,
        camera=Camera(width=_WIDTH, height=_HEIGHT, fx=525.0, fy=525.0, cx=319.5, cy=239.5),
        world_from_camera=np.eye(4),
    )  # fmt: skip


def _tensors(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    noise = rng.normal(0, 1, (_CHANNELS, _PROTO, _PROTO)).astype(np.float32)
    prototypes = np.stack([cv2.GaussianBlur(one, (0, 0), 6) * 10 for one in noise]).astype(np.float32)
    predictions = np.zeros((5 + _CHANNELS, _ANCHORS), dtype=np.float32)
    predictions[:4] = 8
    predictions[4] = rng.uniform(0, 0.05, _ANCHORS)
    anchors = rng.permutation(_ANCHORS)
    for i in range(_MASKS + 20):
        size = rng.uniform(20, 200, 2)
        center = rng.uniform((40, 100), (600, 540))
        coefficients = rng.normal(0, 1, _CHANNELS)
        for anchor in anchors[8 * i : 8 * i + 8]:
            predictions[:2, anchor] = center + rng.normal(0, 0.3, 2)
            predictions[2:4, anchor] = size
            predictions[4, anchor] = rng.uniform(0.5, 0.95)
            predictions[5:, anchor] = coefficients
    return predictions[None], prototypes[None]


def _network() -> SimpleNamespace:
    outputs = (
        Tensor(name="predictions", shape=(1, 5 + _CHANNELS, _ANCHORS), dtype="float"),
        Tensor(name="prototypes", shape=(1, _CHANNELS, _PROTO, _PROTO), dtype="float"),
    )
    return SimpleNamespace(outputs=outputs, require_image_input=lambda _kind: (_SIDE, _SIDE))
