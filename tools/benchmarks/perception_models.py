"""What FastSAM costs beside the network itself: a helper of `tools/bench perception`."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from hickory_stream.geometry.camera import Camera
from hickory_stream.perception.masks import MaskConfig, compose
from hickory_stream.perception.models.fastsam import FastSam, FastSamConfig
from hickory_stream.perception.models.preprocessing import letterbox_of, letterboxed
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from hickory_stream.records import Frame
from tools.benchmarks.figures import Figure

if TYPE_CHECKING:
    from numpy.typing import NDArray

_WIDTH, _HEIGHT, _SIDE, _PROTO, _CHANNELS, _ANCHORS, _MASKS = 640, 480, 640, 160, 32, 8400, 100


def measure_models(seed: int) -> list[Figure]:
    """Return the figures that `tools/bench perception` has of the networks."""
    return [fastsam_prepost_ms(seed), mask_pipeline_ms(seed)]


def mask_pipeline_ms(seed: int, repeats: int = 15) -> Figure:
    """Return the time that the pipeline shared by all segmenters takes for 100 masks of a frame, on one core.

    Before a wall 2 m away, with a step in it that some masks stand out by; the surface of the frame is not counted:
    every segmenter needs it. Processor time, the least of the repeats.
    """
    predictions, prototypes = _tensors(np.random.default_rng(seed))
    fastsam = FastSam(_Outputs(), FastSamConfig(max_masks=_MASKS), warm_up=False)  # type: ignore[arg-type]
    masks, _not_finite = fastsam.decode(predictions, prototypes, _WIDTH, _HEIGHT)
    depth = np.full((_HEIGHT, _WIDTH), 2.0, dtype=np.float32)
    depth[:, _WIDTH // 2 :] = 1.8
    camera = Camera(width=_WIDTH, height=_HEIGHT, fx=525.0, fy=525.0, cx=319.5, cy=239.5)
    frame = Frame(
        index=0,
        stamp_ns=0,
        rgb=np.zeros((_HEIGHT, _WIDTH, 3), np.uint8),
        depth_m=depth,
        camera=camera,
        world_from_camera=np.eye(4),
    )
    surface, nothing = surface_of(frame, SurfaceConfig()), np.zeros((_HEIGHT, _WIDTH), dtype=bool)
    times = []
    for _ in range(repeats):
        started = time.process_time()
        compose(masks, surface, nothing, MaskConfig())
        times.append(time.process_time() - started)
    return Figure(name="mask_pipeline_ms", value=1e3 * min(times), unit="ms", better="lower")


def fastsam_prepost_ms(seed: int, repeats: int = 30) -> Figure:
    """Return the time of the letterbox, the decoding, the suppression and 100 masks at 640 x 480, on one core.

    The tensors are those of a network that sees 100 blobs, each found by several anchors among 8,400; processor time of
    this thread, the least of the repeats: others share the machine.
    """
    rng = np.random.default_rng(seed)
    predictions, prototypes = _tensors(rng)
    rgb = rng.integers(0, 255, (_HEIGHT, _WIDTH, 3), np.uint8)
    fastsam = FastSam(_Outputs(), FastSamConfig(max_masks=_MASKS), warm_up=False)  # type: ignore[arg-type]
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        times = []
        for _ in range(repeats):
            started = time.process_time()
            letterboxed(rgb, letterbox_of(_WIDTH, _HEIGHT, _SIDE, _SIDE))
            masks, _not_finite = fastsam.decode(predictions, prototypes, _WIDTH, _HEIGHT)
            times.append(time.process_time() - started)
    finally:
        cv2.setNumThreads(threads)
    assert len(masks) == _MASKS, f"{len(masks)} masks, expected {_MASKS}"
    return Figure(name="fastsam_prepost_ms", value=1e3 * min(times), unit="ms", better="lower")


def _tensors(rng: np.random.Generator) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return predictions (1, 37, 8400) and prototypes (1, 32, 160, 160) of 100 blobs of 20 to 200 px."""
    prototypes = np.stack([_smooth(rng) for _ in range(_CHANNELS)]).astype(np.float32)
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


def _smooth(rng: np.random.Generator) -> NDArray[np.float32]:
    noise = rng.normal(0, 1, (_PROTO, _PROTO)).astype(np.float32)
    return np.asarray(cv2.GaussianBlur(noise, (0, 0), 6) * 10, dtype=np.float32)


class _Outputs:
    """Stands for the network, which the figure leaves out: only the shapes of its tensors."""

    outputs: tuple[Any, ...]

    def __init__(self) -> None:
        from hickory_stream.perception.models.network import Tensor

        self.outputs = (
            Tensor(name="predictions", shape=(1, 5 + _CHANNELS, _ANCHORS), dtype="float"),
            Tensor(name="prototypes", shape=(1, _CHANNELS, _PROTO, _PROTO), dtype="float"),
        )

    def require_image_input(self, _kind: str) -> tuple[int, int]:
        return _SIDE, _SIDE
