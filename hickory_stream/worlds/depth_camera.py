"""The defects of a stereo depth camera, applied in disparity, in which stereo noise is constant."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.depth_sensor import DepthSensor


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthCameraConfig:
    """A ZED 2i: the baseline of 12 cm is from its data sheet, the other values are estimated from its depth images."""

    baseline_m: float = 0.12
    min_depth_m: float = 0.3
    max_depth_m: float = 8.0
    disparity_sigma_px: float = 0.06
    correlation_px: float = 3.2
    """The correlation radius of the noise: neighbours are matched with overlapping windows."""
    white_share: float = 0.1
    """The part of the noise's standard deviation that is independent from pixel to pixel."""
    disparity_step_px: float = 1 / 16
    grazing_cosine: float = 0.22
    """Below this cosine between ray and normal, returns are lost with increasing probability, up to 1 at cosine 0."""
    edge_ratio: float = 0.05
    """Relative difference in depth between neighbours above which there is an edge between them."""
    edge_loss: float = 0.35
    flying_share: float = 0.25
    """The share of the remaining edge pixels that become flying pixels, between the two depths."""
    dropout_share: float = 0.045
    """The share of the image that is lost in patches, as where matching fails."""

    def sensor(self, focal_px: float) -> DepthSensor:
        """Return the sensor model of the camera for a focal length of `focal_px`.

        Rendering uses its range, but not its noise and steps: those are kept in pixels of disparity, since a conversion
        back from the model would change the last bits, and with them the bytes of logs.
        """
        constant = focal_px * self.baseline_m
        return DepthSensor(
            noise_per_m=self.disparity_sigma_px / constant,
            step_per_m=self.disparity_step_px / constant,
            min_m=self.min_depth_m,
            max_m=self.max_depth_m,
        )


D455 = DepthCameraConfig(baseline_m=0.095, min_depth_m=0.4, max_depth_m=6.0, disparity_sigma_px=0.08)
"""A RealSense D455 in the range that Intel recommends; its noise is that of `players/profiles/realsense.toml`."""


def sensed_depth(
    depth_m: NDArray[np.float32],
    cosine: NDArray[np.float32],
    focal_px: float,
    config: DepthCameraConfig,
    rng: np.random.Generator,
    is_blind: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Return the (H, W) depth that the camera reports for exact depth and incidence; NaN where it reports nothing.

    `is_blind` (H, W) are pixels without texture to match, such as glass.
    """
    near, far, is_edge = _edges(depth_m, config.edge_ratio)
    flies = is_edge & (rng.random(depth_m.shape) < config.flying_share)
    depth = np.where(flies, near + (far - near) * rng.random(depth_m.shape), depth_m)
    constant = focal_px * config.baseline_m
    disparity = constant / depth + _disparity_noise(depth.shape, config, rng)
    lost = (
        ~np.isfinite(depth_m)
        | _is_occluded(constant / depth_m)
        | (rng.random(depth.shape) < np.clip(1.0 - cosine / config.grazing_cosine, 0.0, 1.0))
        | (is_edge & (rng.random(depth.shape) < config.edge_loss))
        | _patches(depth.shape, config.dropout_share, rng)
    )
    steps = np.round(disparity / config.disparity_step_px)
    with np.errstate(divide="ignore"):
        sensed = constant / (steps * config.disparity_step_px)
    if is_blind is not None:
        lost |= is_blind
    sensor = config.sensor(focal_px)
    lost |= ~((sensed >= sensor.min_m) & (sensed <= sensor.max_m))
    return np.where(lost, np.nan, sensed).astype(np.float32)


def _edges(
    depth_m: NDArray[np.float32], ratio: float
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]:
    # Least and greatest depth of each pixel's 3x3 neighbourhood, and whether it contains an edge.
    filled = np.where(np.isfinite(depth_m), depth_m, np.float32(100.0))
    kernel = np.ones((3, 3), dtype=np.uint8)
    near, far = cv2.erode(filled, kernel), cv2.dilate(filled, kernel)
    return near, far, far - near > ratio * near


def _disparity_noise(
    shape: tuple[int, ...], config: DepthCameraConfig, rng: np.random.Generator
) -> NDArray[np.float64]:
    smooth = _smooth_noise(shape, config.correlation_px, rng)
    white = rng.standard_normal(shape)
    share = config.white_share
    return config.disparity_sigma_px * (np.sqrt(1 - share**2) * smooth + share * white)


def _smooth_noise(shape: tuple[int, ...], radius_px: float, rng: np.random.Generator) -> NDArray[np.float64]:
    blurred = cv2.GaussianBlur(rng.standard_normal(shape), (0, 0), radius_px)
    # The sum of the squared weights of a Gaussian kernel is 1 / (4 pi sigma^2).
    return np.asarray(blurred * (2 * np.sqrt(np.pi) * radius_px))


def _is_occluded(disparity: NDArray[Any]) -> NDArray[np.bool_]:
    # A pixel at x is matched at x - d; a pixel further right that is matched at or left of there occludes it.
    columns = np.arange(disparity.shape[1])[None]
    landing = np.where(np.isfinite(disparity), columns - disparity, np.inf)
    from_right = np.minimum.accumulate(landing[:, ::-1], axis=1)[:, ::-1]
    behind = np.full_like(landing, np.inf)
    behind[:, :-1] = from_right[:, 1:]
    return np.asarray(behind < landing)


def _patches(shape: tuple[int, ...], share: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    noise = _smooth_noise(shape, 6.0, rng)
    return np.asarray(noise > np.quantile(noise, 1.0 - share))
