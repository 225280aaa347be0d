import numpy as np
import pytest
from hickory_stream.box_scene import PERIOD_NS, START_NS, SceneSource
from hickory_stream.errors import InputError, RecordingError
from players.faults import FAULTS, Faults, FaultySource, parse_faults

NUM_FRAMES = 12


def _frames(seed=3, **faults):
    source = FaultySource(SceneSource(NUM_FRAMES), Faults(**faults), seed)
    return list(source.frames()), source


def _numbers(frames):
    return [(frame.stamp_ns - START_NS) // PERIOD_NS for frame in frames]


def test_without_faults_nothing_is_changed():
    frames, source = _frames()
    assert _numbers(frames) == list(range(NUM_FRAMES))
    assert source.ledger() == {"frames": NUM_FRAMES}


@pytest.mark.parametrize("name", FAULTS)
def test_the_same_seed_makes_the_same_faults_and_counts_them(name):
    first, source = _frames(**{name: 0.4, "stall_s": 0.0})
    again, _ = _frames(**{name: 0.4, "stall_s": 0.0})
    assert [(f.stamp_ns, f.world_from_camera.tobytes()) for f in first] == [
        (f.stamp_ns, f.world_from_camera.tobytes()) for f in again
    ]
    assert 0 < source.ledger()[f"injected_{name}"] < NUM_FRAMES
    assert [frame.index for frame in first] == list(range(len(first)))


def test_dropped_frames_are_missing_and_doubled_ones_come_twice():
    dropped, source = _frames(drop=0.4)
    assert len(dropped) == NUM_FRAMES - source.ledger()["injected_drop"]
    doubled, source = _frames(duplicate=0.4)
    assert len(doubled) == NUM_FRAMES + source.ledger()["injected_duplicate"]


def test_late_and_swapped_frames_are_out_of_order_and_complete():
    for name in ("delay", "reorder"):
        numbers = _numbers(_frames(**{name: 0.4})[0])
        assert numbers != sorted(numbers)
        assert sorted(numbers) == list(range(NUM_FRAMES))


def test_a_frozen_stamp_is_that_of_the_frame_before():
    numbers = _numbers(_frames(freeze=0.5)[0])
    assert all(number in (i, i - 1) for i, number in enumerate(numbers))
    assert len(set(numbers)) < NUM_FRAMES


def test_a_corrupt_frame_cannot_be_decoded():
    frames, _ = _frames(corrupt=1.0)
    with pytest.raises(RecordingError, match="a fault that was asked for"):
        frames[0].decode()


def test_a_teleported_frame_is_metres_off_and_says_so():
    frames, _ = _frames(teleport=1.0)
    for raw, true in zip(frames, SceneSource(NUM_FRAMES).frames(), strict=True):
        assert np.linalg.norm(raw.world_from_camera[:3, 3] - true.world_from_camera[:3, 3]) > 0.1
        np.testing.assert_array_equal(raw.decode().world_from_camera, raw.world_from_camera)


def test_a_blind_frame_has_no_depth_and_a_shrunken_half_the_size():
    assert not np.isfinite(_frames(blind=1.0)[0][0].decode().depth_m).any()
    small = _frames(shrink=1.0)[0][0]
    frame = small.decode()
    assert frame.camera == small.camera
    assert frame.rgb.shape[:2] == frame.depth_m.shape == (small.camera.height, small.camera.width)


@pytest.mark.parametrize("text", ["drop", "drop=x", "drop=2", "break=0.1", "stall_s=-1", ""])
def test_faults_that_cannot_be_are_refused(text):
    with pytest.raises(InputError, match="found"):
        parse_faults(text)


def test_faults_are_read_from_text():
    assert parse_faults("drop=0.1, teleport=0.02") == Faults(drop=0.1, teleport=0.02)
