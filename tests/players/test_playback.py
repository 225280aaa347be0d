import threading
import pytest
from hickory_stream.box_scene import PERIOD_NS, START_NS, SceneSource
from hickory_stream.cli.runs.play import press
from hickory_stream.errors import InputError
from players.playback import PlaybackClock, PlayedSource


class _Time:
    now_s = 100.0

    def __call__(self):
        return self.now_s


def test_frames_are_due_by_their_stamps_and_the_latest_rate():
    time = _Time()
    clock = PlaybackClock(2.0, time)
    assert clock.due_in_s(START_NS, is_keyframe=False) == 0.0
    assert clock.due_in_s(START_NS + 10**9, is_keyframe=False) == pytest.approx(0.5)
    time.now_s += 0.5
    assert clock.due_in_s(START_NS + 10**9, is_keyframe=False) == 0.0
    time = _Time()
    clock = PlaybackClock(1.0, time)
    clock.due_in_s(START_NS, is_keyframe=False)
    time.now_s += 1.0
    clock.set_rate(0.5)
    clock.due_in_s(START_NS + 10**9, is_keyframe=False)
    assert clock.due_in_s(START_NS + 2 * 10**9, is_keyframe=False) == pytest.approx(2.0)


def test_without_a_rate_frames_are_due_from_stamp_zero_on():
    assert PlaybackClock(None).due_in_s(START_NS, is_keyframe=False) == 0.0
    clock = PlaybackClock(None)
    assert clock.describe() == "at 0.0 s of the log, full speed"
    for stamp_ns in (0, 2_500_000_000):
        clock.wait(stamp_ns)
    assert clock.describe() == "at 2.5 s of the log, full speed"


def test_a_pause_holds_all_but_a_step_to_a_frame_or_keyframe():
    clock = PlaybackClock(None)
    clock.pause(True)
    assert clock.due_in_s(START_NS, is_keyframe=False) is None
    clock.step()
    assert clock.due_in_s(START_NS, is_keyframe=False) == 0.0
    assert clock.due_in_s(START_NS, is_keyframe=False) is None
    clock = PlaybackClock(None)
    clock.step("keyframe")
    assert [clock.due_in_s(START_NS, is_keyframe=key) for key in (False, False, True, False)] == [0.0, 0.0, 0.0, None]


def test_a_part_of_a_log_is_played_unless_after_its_end():
    seconds = PERIOD_NS / 1e9
    source = PlayedSource(SceneSource(8), PlaybackClock(), start_s=2 * seconds, end_s=5 * seconds)
    frames = list(source.frames())
    assert [(f.index, f.stamp_ns) for f in frames] == [(i, START_NS + (i + 2) * PERIOD_NS) for i in range(4)]
    assert frames[1].decode().index == 1
    assert source.info.num_frames is None
    assert source.ledger()["frames_skipped"] == 2
    source = PlayedSource(SceneSource(4), PlaybackClock(), start_s=60.0)
    with pytest.raises(InputError, match=r"--start 60, but the log is only \d+\.\d s long"):
        next(source.frames())


def test_a_seek_forward_skips_and_a_seek_back_begins_again():
    clock = PlaybackClock()
    source = PlayedSource(SceneSource(8), clock)
    shown = []
    for frame in source.frames():
        shown.append((frame.stamp_ns - START_NS) // PERIOD_NS)
        if len(shown) == 2:
            clock.seek(5 * PERIOD_NS / 1e9)
        if len(shown) == 4:
            clock.seek(-3 * PERIOD_NS / 1e9, relative=True)
    assert shown == [0, 1, 5, 6, 3, 4, 5, 6, 7]


def test_stopping_wakes_whoever_waits():
    clock = PlaybackClock(None)
    clock.pause(True)
    source = PlayedSource(SceneSource(2), clock)
    frames = []
    thread = threading.Thread(target=lambda: frames.extend(source.frames()))
    thread.start()
    source.interrupt()
    thread.join(10)
    assert not thread.is_alive()
    assert len(frames) == 2


def test_keys_drive_the_clock():
    clock = PlaybackClock(1.0)
    pauses = []
    for key in (b" ", b" ", b"."):
        press(clock, key)
        pauses.append(clock.is_paused)
    assert pauses == [True, False, True]
    rates = []
    for key in (b"\x1b[A", b"\x1b[B", b"\x1b[B", b"?"):
        press(clock, key)
        rates.append(clock.rate)
    assert rates == [2.0, 1.0, 0.5, 0.5]
    clock.position_ns, clock.first_ns = START_NS, START_NS
    press(clock, b"\x1b[C")
    assert clock.take_seek() == START_NS + 10 * 10**9
