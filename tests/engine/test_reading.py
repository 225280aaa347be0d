"""What a run makes of a frame before anybody sees it: its depth, and whether time jumped before it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hickory_stream.engine.reading import Read, sensed, time_jump
from hickory_stream.engine.step import FramePose
from hickory_stream.events import TimeJumped
from hickory_stream.geometry.depth_sensor import DepthSensor, SensorConfig
from hickory_stream.testing import SceneSource

RAW = next(SceneSource(1).frames())
FRAME = RAW.decode()
SECOND_NS = 1_000_000_000


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


@pytest.mark.parametrize(
    ("after_s", "round_index", "kind"),
    [(0.1, 0, None), (0.0, 0, None), (5.1, 0, "seek"), (-0.1, 0, "seek"), (-20.0, 0, "restart"), (-0.1, 1, "loop")],
)
def test_time_jumps_where_stamps_go_back_leave_a_gap_or_begin_again(
    after_s: float, round_index: int, kind: str | None
) -> None:
    last = FramePose(index=9, stamp_ns=100 * SECOND_NS, world_from_camera=np.eye(4))
    stamp_ns = last.stamp_ns + round(after_s * SECOND_NS)
    read = Read(raw=replace(RAW, stamp_ns=stamp_ns), round_index=round_index, first_index=0, is_candidate=True)
    jump = time_jump(last, read, round_index=0, first_ns=90 * SECOND_NS, most_s=5.0)
    assert jump == (None if kind is None else TimeJumped(from_ns=last.stamp_ns, to_ns=stamp_ns, kind=kind))
    assert time_jump(None, read, round_index=0, first_ns=None, most_s=5.0) is None
