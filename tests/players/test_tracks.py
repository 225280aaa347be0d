import numpy as np
import pytest
from hickory_stream.geometry.rigid import (
    from_rotation_translation,
    invert,
    quaternion_from_rotation,
    rotation_angle_rad,
    rotation_of_vector,
    rotation_vector,
    yaw_rotation,
)
from players.poses.tracks import GrowingTrack, JumpLimits

MS = 1_000_000
GAP_NS = 500 * MS


def _walk(t_s):
    """Return a pose on a curved walk at 1 m/s with a sway."""
    position = np.array([t_s, 0.3 * np.sin(1.5 * t_s), 0.02 * np.sin(5 * t_s)])
    return from_rotation_translation(yaw_rotation(0.4 * np.sin(t_s)), position)


def _row(pose):
    return [*pose[:3, 3], *quaternion_from_rotation(pose[:3, :3])]


def _track(poses, limits=None):
    track = GrowingTrack(GAP_NS, limits)
    for t_s, pose in poses:
        track.add(round(t_s * 1e9), _row(pose))
    return track


def _error_m(track, t_s):
    pose = track.at(round(t_s * 1e9))
    return float(np.linalg.norm((invert(_walk(t_s)) @ pose)[:3, 3]))


def test_poses_at_five_hertz_are_a_cubic_that_turns_with_them():
    track = _track([(0.2 * i, _walk(0.2 * i)) for i in range(30)])
    worst = max(_error_m(track, t) for t in np.arange(0.5, 5.0, 0.013))
    before, at, after = (np.array([_walk(t + d)[:3, 3] for t in np.arange(0.5, 5.0, 0.013)]) for d in (-0.1, 0, 0.1))
    straight = np.linalg.norm(at - (before + after) / 2, axis=1).max()
    assert worst < min(2e-3, 0.5 * straight)
    for t in np.arange(0.5, 5.0, 0.1):
        pose = track.at(round(t * 1e9))
        assert rotation_angle_rad(_walk(t)[:3, :3].T @ pose[:3, :3]) < np.radians(0.05)


@pytest.mark.parametrize("vector", [(0.0, 0.0, 0.0), (1e-9, 0, 0), (0.3, -0.2, 0.5), (0.0, 3.0, 0.0)])
def test_a_rotation_vector_is_its_rotation_again(vector):
    np.testing.assert_allclose(rotation_vector(rotation_of_vector(np.array(vector))), vector, atol=1e-9)


def test_gaps_are_refused_unless_one_stood_and_old_poses_gone():
    assert _track([(0.0, _walk(0.0)), (2.0, _walk(2.0))]).at(10**9) is None
    assert _track([(0.0, _walk(0.0)), (2.0, _walk(0.0))]).at(10**9) is not None
    track = _track([(0.01 * i, _walk(0.01 * i)) for i in range(5000)])
    before = track.at(45 * 10**9)
    track.forget(40 * 10**9)
    np.testing.assert_array_equal(track.at(45 * 10**9), before)
    assert track.at(10**9) is None


def test_a_teleport_is_left_out():
    far = from_rotation_translation(np.eye(3), np.array([40.0, 0.0, 0.0]))
    poses = [(0.1 * i, _walk(0.1 * i)) for i in range(20)]
    poses[10] = (1.0, far)
    track = _track(poses, JumpLimits())
    assert track.num_teleports == 1
    assert not track.jumps
    assert _error_m(track, 1.0) < 0.02


def test_a_jump_is_told_and_bridged_and_a_walk_has_none():
    jump = from_rotation_translation(yaw_rotation(0.1), np.array([0.8, -0.5, 0.1]))
    poses = [(0.1 * i, _walk(0.1 * i) if i < 15 else jump @ _walk(0.1 * i)) for i in range(30)]
    track = _track(poses, JumpLimits())
    assert track.num_teleports == 0
    (found,) = track.jumps
    assert found.stamp_ns == 1_500 * MS
    np.testing.assert_allclose(found.after_from_before, jump, atol=0.03)
    assert track.jump_between(1_400 * MS, 1_500 * MS) is found
    assert track.jump_between(1_500 * MS, 1_900 * MS) is None
    assert max(_error_m(track, t) for t in np.arange(1.5, 2.8, 0.1)) < 0.03
    assert track.at(1_450 * MS) is None
    for hz in (5, 10, 30, 100):
        track = _track([(i / hz, _walk(i / hz)) for i in range(5 * hz)], JumpLimits())
        assert not track.jumps
        assert track.num_teleports == 0


def test_a_jump_does_not_tilt_the_world_of_a_body_that_pitches_as_it_walks():
    poses = []
    for i in range(30):
        gait = rotation_of_vector(np.array([0.0, 0.03 * np.cos(4 * np.pi * i / 7), 0.0]))
        walked = _walk(i / 7) @ from_rotation_translation(gait, np.zeros(3))
        poses.append((i / 7, from_rotation_translation(yaw_rotation(0.1), [2.0 * (i > 14), 0, 0]) @ walked))
    track = _track(poses, JumpLimits())
    (found,) = track.jumps
    np.testing.assert_array_equal(found.after_from_before[2, :3], [0.0, 0.0, 1.0])
    tilts = [(pose[:3, :3] @ track.at(round(t * 1e9))[:3, :3].T)[2, 2] for t, pose in poses]
    assert np.arccos(np.clip(min(tilts), -1, 1)) < 1e-6


def _rivals(offset_of):
    track = GrowingTrack(500 * MS, JumpLimits())
    for i in range(300):
        x, y, z = np.array([0.5 * 0.033 * i, 0.0, 0.0]) + offset_of(i)
        track.add(33 * MS * i, [x, y, z, 0.0, 0.0, 0.0, 1.0])
    return track.num_rivals / 300


@pytest.mark.parametrize("every", [2, 4, 6])
@pytest.mark.parametrize("apart_m", [0.08, 0.3, 5.0])
def test_poses_of_another_publisher_go_back_and_forth(apart_m, every):
    assert _rivals(lambda i: [0.0, apart_m * (i % every == 0), 0.0]) > 0.5 / every


def test_noise_and_a_bobbing_gait_are_not_another_publisher():
    rng = np.random.default_rng(3)
    assert _rivals(lambda i: rng.normal(scale=0.02, size=3)) < 0.02
    assert _rivals(lambda i: [0.0, 0.0, 0.02 * np.sin(i)]) == 0.0


def test_a_jump_between_rare_poses_is_no_teleport():
    jump = from_rotation_translation(yaw_rotation(0.03), np.array([0.35, -0.2, 0.05]))
    poses = [(i / 6, _walk(i / 6) if i < 15 else jump @ _walk(i / 6)) for i in range(30)]
    track = _track(poses, JumpLimits(acceleration_mps2=6.0))
    assert [found.stamp_ns for found in track.jumps] == [2_500 * MS]
    assert track.num_teleports == 0
