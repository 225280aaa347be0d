from collections import Counter
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.frame_accounting import FrameOutcome, KeyframeChoice, RunClock
from hickory_stream.engine.reading import QueuedFrame
from hickory_stream.events import TimeJumped
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.inspection.inspect import format_table, summarize
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.mapping.rules.keyframes import Keyframe, KeyframeConfig, keyframe_reason
from hickory_stream.testing import InstanceSegmenter
from players.doctor.report import _frames_line
from tests.engine.run_fixtures import NO_SHAPES, map_scene
from tests.mapping.mapping_fixtures import yaw_rotation
from tests.players.test_doctor import _judged

RAW = next(SceneSource(1).frames())
CONFIG = KeyframeConfig()
FAR_M = 10.0


def read(place_m, *, is_candidate, is_corrupt=False, seconds=0.0):
    """Return a frame so far along x: a keyframe of its own wherever it is far from the last one."""
    pose = np.array(RAW.world_from_camera)
    pose[0, 3] += place_m
    raw = replace(RAW, stamp_ns=RAW.stamp_ns + round(seconds * 1e9), world_from_camera=pose)
    return QueuedFrame(raw=raw, round_index=0, first_index=0, is_candidate=is_candidate, is_corrupt=is_corrupt)


def test_a_playback_maps_candidates_and_counts_corrupt_frames():
    choice = KeyframeChoice("playback", CONFIG)
    assert choice.outcomes([read(0.0, is_candidate=True)]) == [FrameOutcome.MAPPED]
    assert choice.outcomes([read(0.0, is_candidate=False)]) == [FrameOutcome.BETWEEN]
    assert choice.outcomes([read(FAR_M, is_candidate=False, is_corrupt=True)]) == [FrameOutcome.UNDECODABLE]


def test_a_live_run_maps_the_newest_candidate_alone():
    choice = KeyframeChoice("live", CONFIG)
    come = [read(i * FAR_M, is_candidate=i % 2 == 0, seconds=i) for i in range(5)]
    assert choice.outcomes(come) == [
        FrameOutcome.DROPPED,
        FrameOutcome.BETWEEN,
        FrameOutcome.DROPPED,
        FrameOutcome.BETWEEN,
        FrameOutcome.MAPPED,
    ]


def test_a_candidate_is_mapped_dropped_or_replaced():
    choice = KeyframeChoice("live", CONFIG)
    come = [read(0.0, is_candidate=True), read(FAR_M, is_candidate=False, seconds=1.0)]
    assert choice.outcomes(come) == [FrameOutcome.BETWEEN, FrameOutcome.MAPPED]
    assert choice.outcomes([read(0.0, is_candidate=True)]) == [FrameOutcome.MAPPED]
    assert choice.outcomes([read(0.0, is_candidate=True)]) == [FrameOutcome.DROPPED]
    assert choice.outcomes([read(0.0, is_candidate=False)]) == [FrameOutcome.BETWEEN]


SECOND_NS = 1_000_000_000
START_NS, LAST_NS = 90 * SECOND_NS, 100 * SECOND_NS


def read_at(stamp_ns, *, index=0, round_index=0, first_index=0):
    raw = replace(RAW, index=index, stamp_ns=stamp_ns)
    return QueuedFrame(raw=raw, round_index=round_index, first_index=first_index, is_candidate=True)


@pytest.fixture
def clock():
    """A clock after two frames, ten seconds apart."""
    clock = RunClock(time_jump_s=5.0)
    clock.advance(read_at(START_NS))
    clock.advance(read_at(LAST_NS, index=1))
    return clock


@pytest.mark.parametrize(
    ("after_s", "round_index", "kind"),
    [(0.1, 0, None), (0.0, 0, None), (5.1, 0, "seek"), (-0.1, 0, "seek"), (-20.0, 0, "restart"), (-0.1, 1, "loop")],
)
def test_time_jumps_at_steps_back_gaps_and_new_rounds(clock, after_s, round_index, kind):
    stamp_ns = LAST_NS + round(after_s * SECOND_NS)
    jump = clock.jump_before(read_at(stamp_ns, round_index=round_index))
    assert jump == (None if kind is None else TimeJumped(from_ns=LAST_NS, to_ns=stamp_ns, kind=kind))


def test_before_the_first_frame_nothing_has_jumped():
    assert RunClock(time_jump_s=5.0).jump_before(read_at(START_NS)) is None


def test_it_stands_at_the_last_frame_and_keeps_the_first_stamp(clock):
    pose = clock.advance(read_at(LAST_NS + SECOND_NS, index=7, round_index=2, first_index=5))
    assert clock.last is pose
    assert (pose.index, pose.stamp_ns) == (7, LAST_NS + SECOND_NS)
    assert (clock.round_index, clock.first_index, clock.num_frames) == (2, 5, 3)
    assert clock.first_ns == START_NS
    assert clock.camera == RAW.camera


@pytest.mark.parametrize(("seconds", "rate_hz", "speed_m_s", "turn_deg_s", "counts"), [
    (3600, 5, 0.0, 0.0, {"first": 1, "at_rest": 1799}), (60, 30, 0.0, 90.0, {"first": 1, "moved": 149}),
    (60, 1, 0.3, 0.0, {"first": 1, "moved": 59}), (30, 60, 0.5, 0.0, {"first": 1, "moved": 74}),
])  # fmt: skip
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
