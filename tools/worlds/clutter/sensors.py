"""Random cameras: field of view, and defects of colour and depth."""

from __future__ import annotations

import numpy as np

from hickory_stream.geometry.camera import Camera
from hickory_stream.worlds.depth_camera import DepthCameraConfig
from tools.worlds.clutter.draws import chance, log_uniform, uniform
from tools.worlds.color_camera import ColorCameraConfig


def random_camera(rng: np.random.Generator, width: int, height: int) -> Camera:
    """Return a pinhole camera of 50 to 100 degrees across, its optical axis near the middle."""
    focal = width / 2 / np.tan(np.radians(uniform(rng, 50.0, 100.0)) / 2)
    return Camera(
        width=width,
        height=height,
        fx=float(focal),
        fy=float(focal * uniform(rng, 0.99, 1.01)),
        cx=(width - 1) / 2 + float(rng.normal(0, 0.01 * width)),
        cy=(height - 1) / 2 + float(rng.normal(0, 0.01 * height)),
    )


def random_depth_camera(rng: np.random.Generator, focal_px: float) -> DepthCameraConfig:
    """Return a stereo or structured-light camera, from good to poor.

    Its noise is drawn in depth, 0.1 % to 0.8 % at one metre, and grows with the square of depth. The noise of disparity
    follows from it by baseline and focal length, so that small images are not noisier than large ones.
    """
    baseline = log_uniform(rng, 0.05, 0.2)
    sigma = log_uniform(rng, 0.0008, 0.006) * baseline * focal_px
    return DepthCameraConfig(
        baseline_m=baseline,
        min_depth_m=uniform(rng, 0.15, 0.45),
        max_depth_m=log_uniform(rng, 4.0, 12.0),
        disparity_sigma_px=sigma,
        correlation_px=uniform(rng, 1.0, 4.0),
        white_share=uniform(rng, 0.05, 0.8),
        disparity_step_px=sigma * log_uniform(rng, 0.3, 2.5),
        grazing_cosine=uniform(rng, 0.08, 0.3),
        edge_ratio=uniform(rng, 0.03, 0.08),
        edge_loss=uniform(rng, 0.0, 0.7),
        flying_share=uniform(rng, 0.0, 0.5),
        dropout_share=uniform(rng, 0.0, 0.1) if chance(rng, 0.8) else 0.0,
    )


def random_color_camera(rng: np.random.Generator, width: int) -> ColorCameraConfig:
    """Return the defects of a colour image: exposure, tint, blur, noise, and displacement from depth."""
    scale = width / 320
    off = scale * log_uniform(rng, 0.2, 2.5) if chance(rng, 0.6) else 0.0
    moving = 0.3 * scale * log_uniform(rng, 1.0, 25.0) if chance(rng, 0.25) else 0.0
    turn = uniform(rng, 0, 2 * np.pi)
    return ColorCameraConfig(
        exposure=log_uniform(rng, 0.55, 1.5),
        gamma=log_uniform(rng, 0.7, 1.35),
        warmth=float(rng.normal(0, 0.12)),
        vignette=uniform(rng, 0.0, 0.5) if chance(rng, 0.5) else 0.0,
        blur_px=uniform(rng, 0.0, 1.1) * scale,
        motion_px=(float(moving * np.cos(turn)), float(moving * np.sin(turn))),
        noise=log_uniform(rng, 0.5, 10.0),
        shift_px=(float(off * rng.normal(0, 0.7)), float(off * rng.normal(0, 0.4))),
        skew_px=float(off * rng.normal(0, 0.7)),
        wobble_px=0.25 * off,
    )
