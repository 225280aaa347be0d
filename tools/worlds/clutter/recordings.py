"""Logs of random rooms, recorded with a random camera, camera height and odometry."""

from __future__ import annotations

import numpy as np

from hickory_stream.worlds.walk_config import WalkConfig
from tools.worlds.clutter.draws import chance, log_uniform, uniform
from tools.worlds.clutter.families import FAMILIES, recipes_of
from tools.worlds.clutter.sensors import random_camera, random_color_camera, random_depth_camera
from tools.worlds.drift import DriftConfig
from tools.worlds.recording_config import RecordingConfig
from tools.worlds.scenes import CLUTTER

_SIZES = ((320, 240), (424, 240), (640, 360), (640, 480), (848, 480))


def clutter_recording(
    seed: int,
    family: str,
    *,
    seconds: float = 12.0,
    rate_hz: float = 5.0,
    width: int | None = 320,
    height: int = 240,
) -> RecordingConfig:
    """Return the config of a log of a random room, for `cached_recording`; the seed draws camera and odometry too.

    `width` None draws one of the usual image sizes. Camera heights are 0.3 to 1.8 m, fields of view 50 to 100 degrees.
    In one config of two the odometry is exact, in the other it has noise of millimetres and drifts.

    Raises:
        ConfigError: there is no such family.
    """
    recipes_of(family)
    rng = np.random.default_rng([seed, 23, FAMILIES.index(family)])
    drawn = _SIZES[int(np.random.default_rng([seed, 24]).integers(len(_SIZES)))]
    width, height = drawn if width is None else (width, height)
    camera = random_camera(rng, width, height)
    eye = uniform(rng, 0.3, 1.8)
    # A high camera looks down, a low one ahead.
    middle = float(np.interp(eye, (0.3, 1.8), (2.0, -22.0))) + float(rng.normal(0, 5.0))
    drift = None
    if chance(rng, 0.5):
        drift = DriftConfig(jitter_m=log_uniform(rng, 0.0005, 0.006), jitter_deg=log_uniform(rng, 0.02, 0.3))
    return RecordingConfig(
        scene=CLUTTER,
        family=family,
        seed=seed,
        seconds=seconds,
        rate_hz=rate_hz,
        width=width,
        height=height,
        horizontal_fov_deg=float(np.degrees(2 * np.arctan(width / 2 / camera.fx))),
        color_noise=0.0,
        jpeg_quality=int(rng.integers(60, 96)),
        drift=drift,
        color=random_color_camera(rng, width),
        walk=WalkConfig(
            speed_mps=uniform(rng, 0.2, 0.7),
            eye_height_m=eye,
            clearance_m=0.22,
            pitch_deg=(middle - 12.0, middle + 12.0),
        ),
        depth=random_depth_camera(rng, camera.fx),
    )
