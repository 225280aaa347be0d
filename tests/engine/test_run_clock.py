from dataclasses import replace
import pytest
from hickory_stream.box_scene import SceneSource
from hickory_stream.engine.frame_accounting import RunClock
from hickory_stream.engine.reading import QueuedFrame
from hickory_stream.events import TimeJumped

RAW = next(SceneSource(1).frames())
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
