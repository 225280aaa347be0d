"""How many keyframes a log gives, and why: a camera that rests, spins, is slow, fast or covered."""

from collections import Counter
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.inspection.inspect import format_table, summarize
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.mapping.rules.keyframes import Keyframe, KeyframeConfig, keyframe_reason
from hickory_stream.testing import InstanceSegmenter
from players.doctor.report import _frames_line
from tests.engine.run_fixtures import NO_SHAPES, map_scene
from tests.mapping.mapping_fixtures import yaw_rotation
from tests.players.test_doctor import _judged


@pytest.mark.parametrize(
    ("seconds", "rate_hz", "speed_m_s", "turn_deg_s", "counts"),
    [
        (3600, 5, 0.0, 0.0, {"first": 1, "at_rest": 1799}),
        (60, 30, 0.0, 90.0, {"first": 1, "moved": 149}),
        (60, 1, 0.3, 0.0, {"first": 1, "moved": 59}),
        (30, 60, 0.5, 0.0, {"first": 1, "moved": 74}),
    ],
)
def test_keyframes_follow_motion_and_not_the_rate(seconds, rate_hz, speed_m_s, turn_deg_s, counts):
    last, reasons = None, Counter()
    for i in range(seconds * rate_hz):
        rotation = yaw_rotation(np.deg2rad(turn_deg_s * i / rate_hz))
        pose = from_rotation_translation(rotation, np.array([speed_m_s * i / rate_hz, 0.0, 0.0]))
        stamp_ns = round(1e9 * i / rate_hz)
        if (reason := keyframe_reason(last, stamp_ns, pose, KeyframeConfig(min_interval_s=0.4))) is not None:
            last = Keyframe(stamp_ns=stamp_ns, world_from_camera=pose)
            reasons[reason] += 1
    assert reasons == counts


def test_the_doctor_reports_keyframes_of_a_camera_at_rest():
    found = _judged([(0.5 * i, 0.0 if i < 20 else 0.1 * (i - 20), 0.0) for i in range(40)])
    assert (found.frames["keyframes"], found.frames["keyframes_at_rest"]) == (15, 5)
    assert "due at this motion, 5 of a camera at rest)" in _frames_line(found.frames)


class _Covered(SceneSource):
    """A scene whose camera is covered from the fourth frame on."""

    def _decode(self, index):
        frame = super()._decode(index)
        return replace(frame, depth_m=np.full_like(frame.depth_m, np.nan)) if index > 3 else frame


def test_inspect_reports_a_camera_that_rests_and_is_covered(tmp_path):
    source = _Covered(8, period_ns=1_000_000_000, step_of=lambda _: 0)
    map_scene(tmp_path, *NO_SHAPES, source=source, segmenter=InstanceSegmenter(source.instances))
    summary = summarize(open_map(tmp_path / "map"))
    assert summary.frames == {
        "read": 8, "keyframes": 4, "keyframes_at_rest": 3, "keyframes_without_depth": 2, "between_keyframes": 4,
    }  # fmt: skip
    assert "4 keyframes (3 of a camera at rest, 2 without depth) of 8 frames" in format_table(summary)
