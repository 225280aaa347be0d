"""A training example: a frame with defects of depth and colour drawn anew each time, and its target affinities."""
# Colour is left out a quarter of the time, so that depth leads; height and scale half of the time; the assumed noise is
# not the true one.

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.perception.affinity.pixel_inputs import CHANNELS, ZERO, pixel_inputs
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from hickory_stream.records import Frame
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from tools.network_training.frames import TrueFrame

UNKNOWN = -1
_COLORS = [i for i, name in enumerate(CHANNELS) if name in ("light", "green_red", "blue_yellow")]
_SCALE = CHANNELS.index("scale")
_MIRRORED = CHANNELS.index("normal_right")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lesson:
    """Bytes (NUM_INPUTS, H, W), and (H / 2, W / 2) the thing at each pixel of the output."""

    # 0 is structure, `UNKNOWN` what is not to be learnt.
    inputs: NDArray[np.uint8]
    labels: NDArray[np.int32]


def lesson_of(frame: TrueFrame, rng: np.random.Generator) -> Lesson:
    depth = _defective_depth(frame, rng)
    pose = _tilted(frame.world_from_camera, rng)
    seen = Frame(
        index=0, stamp_ns=0, rgb=_changed_color(frame.rgb, rng), depth_m=depth, camera=frame.camera,
        world_from_camera=pose,
        sensor=DepthSensor(noise_per_m=float(np.exp(rng.uniform(np.log(0.0012), np.log(0.0035))))),
    )  # fmt: skip
    surface = surface_of(seen, SurfaceConfig())
    inputs = pixel_inputs(surface, float(rng.normal(0, 0.02)) if rng.random() < 0.5 else None)
    if rng.random() < 0.25:
        inputs[_COLORS] = ZERO
    if rng.random() < 0.5:
        inputs[_SCALE] = ZERO
    labels = np.full((inputs.shape[1] // 2, inputs.shape[2] // 2), UNKNOWN, dtype=np.int32)
    half = np.where(np.isnan(surface.depth_m), UNKNOWN, frame.instances)[::2, ::2]
    labels[: half.shape[0], : half.shape[1]] = half
    if rng.random() < 0.5:
        inputs, labels = _mirrored(inputs, surface.depth_m.shape[1], labels)
    return Lesson(inputs=inputs, labels=labels)


def _mirrored(
    inputs: NDArray[np.uint8], width: int, labels: NDArray[np.int32]
) -> tuple[NDArray[np.uint8], NDArray[np.int32]]:
    out, named = inputs.copy(), labels.copy()
    # One column more to the right, so that even pixels stay even.
    out[:, :, 1:width] = inputs[:, :, 1:width][:, :, ::-1]
    named[:, 1 : width // 2] = labels[:, 1 : width // 2][:, ::-1]
    named[:, 0] = UNKNOWN
    out[_MIRRORED] = np.clip(2 * ZERO - out[_MIRRORED].astype(np.int32), 0, 255).astype(np.uint8)
    return np.ascontiguousarray(out), np.ascontiguousarray(named)


def drawn_camera(rng: np.random.Generator) -> DepthCameraConfig:
    sigma_px = float(np.exp(rng.uniform(np.log(0.004), np.log(0.06))))
    return DepthCameraConfig(
        baseline_m=float(rng.uniform(0.05, 0.12)), min_depth_m=0.25, max_depth_m=float(rng.uniform(4.0, 8.0)),
        disparity_sigma_px=sigma_px, correlation_px=float(rng.uniform(0.6, 2.0)),
        white_share=float(rng.uniform(0.05, 0.7)), disparity_step_px=sigma_px * float(rng.uniform(0.2, 1.2)),
        edge_loss=float(rng.uniform(0.0, 0.5)), flying_share=float(rng.uniform(0.0, 0.35)),
        dropout_share=float(rng.uniform(0.001, 0.08)), grazing_cosine=float(rng.uniform(0.02, 0.25)),
    )  # fmt: skip


def _defective_depth(frame: TrueFrame, rng: np.random.Generator) -> NDArray[np.float32]:
    config = drawn_camera(rng)
    if frame.sensed_m is not None and rng.random() < 0.5:
        depth = frame.sensed_m
    else:
        depth = sensed_depth(frame.depth_m, frame.cosine, frame.camera.fx, config, rng)
    if rng.random() < 0.2:
        kernel = int(rng.choice([3, 5]))
        filled = cv2.medianBlur(np.nan_to_num(depth), kernel)
        depth = np.where(np.isnan(depth) | (filled <= 0), depth, filled).astype(np.float32)
    return depth


def _tilted(world_from_camera: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.float64]:
    turned, _ = cv2.Rodrigues(np.array([*rng.normal(0, 0.015, 2), 0.0]))
    return from_rotation_translation(turned @ world_from_camera[:3, :3], world_from_camera[:3, 3])


def _changed_color(rgb: NDArray[np.uint8], rng: np.random.Generator) -> NDArray[np.uint8]:
    color = rgb.astype(np.float32) / np.float32(255)
    if rng.random() < 0.3:
        color = cv2.GaussianBlur(color, (0, 0), float(rng.uniform(0.3, 1.6)))
    if rng.random() < 0.15:
        color = np.repeat(color.mean(axis=2, keepdims=True), 3, axis=2)
    elif rng.random() < 0.5:
        # Hues are turned about grey.
        turned, _ = cv2.Rodrigues(np.full(3, rng.uniform(-np.pi, np.pi) / np.sqrt(3)))
        color = color @ turned.T.astype(np.float32)
    color = np.clip(color, 0, 1) ** np.float32(np.exp(rng.normal(0, 0.4)))
    color = color * np.exp(rng.normal(0, 0.25) + rng.normal(0, 0.08, 3)).astype(np.float32)
    color = color + rng.normal(0, float(rng.uniform(0, 0.04)), color.shape).astype(np.float32)
    if rng.random() < 0.3:
        shift = np.array([[1, 0, rng.normal(0, 1.2)], [0, 1, rng.normal(0, 1.2)]], dtype=np.float32)
        size = (rgb.shape[1], rgb.shape[0])
        color = cv2.warpAffine(color, shift, size, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray((np.clip(color, 0, 1) * 255).round().astype(np.uint8))
