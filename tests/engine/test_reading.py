"""What a run makes of a frame before anybody sees it: its number and its depth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.reading import sensed
from hickory_stream.geometry.depth_sensor import DepthSensor, SensorConfig

RAW = next(SceneSource(1).frames())
FRAME = RAW.decode()


def test_without_a_configured_sensor_a_frame_stays_what_the_source_gave() -> None:
    frame = sensed(FRAME, 7, SensorConfig())
    assert (frame.index, frame.sensor) == (7, FRAME.sensor)
    assert frame.depth_m is FRAME.depth_m


def test_a_configured_bias_takes_the_place_of_the_one_that_the_source_took_off() -> None:
    source = replace(FRAME, sensor=DepthSensor(bias_m=0.03, noise_per_m=0.001))
    frame = sensed(source, 0, SensorConfig(bias_m=0.05, max_m=2.5))
    assert frame.sensor == DepthSensor(bias_m=0.05, noise_per_m=0.001, max_m=2.5)
    left = FRAME.depth_m - np.float32(0.02)
    np.testing.assert_allclose(frame.depth_m, np.where(left <= 2.5, left, np.nan), atol=1e-6)
    assert 0 < np.isfinite(frame.depth_m).mean() < np.isfinite(FRAME.depth_m).mean()
