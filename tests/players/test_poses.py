import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import is_rigid, quaternion_from_rotation, rotation_angle_rad, yaw_rotation
from players.poses.interpolation import HOLD_NS, nearest_rigid, track_of, world_from_down

MS = 1_000_000
numbers = st.floats(-5, 5, allow_nan=False, width=32)
rows = st.tuples(*[numbers] * 7).filter(lambda row: np.linalg.norm(row[3:]) > 0.1).map(list)
tracks = st.lists(st.tuples(st.integers(0, 5000), rows), min_size=1, max_size=12, unique_by=lambda entry: entry[0])


def _yaw_row(x, yaw):
    return [x, 0.0, 0.0, *quaternion_from_rotation(yaw_rotation(yaw)).tolist()]


def _track(entries, gap_ms=10_000):
    return track_of([ms * MS for ms, _ in entries], [row for _, row in entries], gap_ms * MS)


@given(tracks)
def test_a_track_returns_its_poses_at_their_stamps(entries):
    track = _track(entries)
    for ms, row in entries:
        np.testing.assert_allclose(track.at(ms * MS)[:3, 3], row[:3])


@given(tracks, st.integers(0, 5000))
def test_an_interpolated_pose_is_rigid_and_between_neighbours(entries, ms):
    pose = _track(entries).at(ms * MS)
    stamps = sorted(stamp for stamp, _ in entries)
    if pose is None:
        assert ms < stamps[0] or ms > stamps[-1]
        return
    assert is_rigid(pose, 1e-6)
    positions = dict(entries)
    before = max((s for s in stamps if s <= ms), default=stamps[0])
    after = min((s for s in stamps if s >= ms), default=stamps[-1])
    low = np.minimum(positions[before][:3], positions[after][:3])
    high = np.maximum(positions[before][:3], positions[after][:3])
    assert (pose[:3, 3] >= low - 1e-9).all()
    assert (pose[:3, 3] <= high + 1e-9).all()


@given(tracks, st.randoms(use_true_random=False), st.integers(0, 5000))
def test_the_order_of_the_poses_does_not_matter(entries, random, ms):
    shuffled = list(entries)
    random.shuffle(shuffled)
    there, here = _track(entries).at(ms * MS), _track(shuffled).at(ms * MS)
    assert (there is None) == (here is None)
    if there is not None:
        np.testing.assert_array_equal(there, here)


@given(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.integers(1, 99))
def test_rotation_turns_at_a_constant_rate_between_two_poses(first, second, ms):
    pose = _track([(0, _yaw_row(0.0, first)), (100, _yaw_row(2.0, second))]).at(ms * MS)
    assert rotation_angle_rad(yaw_rotation(first + (second - first) * ms / 100).T @ pose[:3, :3]) < 1e-7
    np.testing.assert_allclose(pose[:3, 3], [2.0 * ms / 100, 0, 0], atol=1e-12)


def test_poses_are_held_briefly_the_first_of_two_not_over_gaps():
    track = _track([(0, _yaw_row(0, 0)), (100, _yaw_row(1, 0))])
    np.testing.assert_array_equal(track.at(100 * MS + HOLD_NS)[:3, 3], [1, 0, 0])
    np.testing.assert_array_equal(track.at(-HOLD_NS)[:3, 3], [0, 0, 0])
    assert track.at(100 * MS + HOLD_NS + 1) is None
    assert track.at(-HOLD_NS - 1) is None
    assert _track([(0, _yaw_row(0, 0)), (600, _yaw_row(1, 0))], gap_ms=500).at(300 * MS) is None
    assert track_of([], [], 1) is None
    track = track_of([5, 5], [_yaw_row(1, 0), _yaw_row(2, 0)], 1)
    assert track.at(5)[0, 3] == 1


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda d: np.linalg.norm(d) > 0.01))
def test_gravity_points_down_after_the_world_was_turned_upright(down):
    world_from_log = world_from_down(np.array(down))
    assert is_rigid(world_from_log, 1e-6)
    np.testing.assert_allclose(world_from_log[:3, :3] @ (down / np.linalg.norm(down)), [0, 0, -1], atol=1e-6)


@pytest.mark.parametrize("down", [(0.0, 0.0, -1.0), (0.0, 0.0, 1.0)])
def test_an_upright_world_stays_and_one_on_its_head_is_turned(down):
    np.testing.assert_allclose(world_from_down(np.array(down))[:3, :3] @ down, [0, 0, -1], atol=1e-12)


def test_a_printed_rotation_is_made_orthogonal():
    printed = np.eye(4)
    printed[:3, :3] = np.round(yaw_rotation(0.3), 3)
    rigid = nearest_rigid(printed)
    assert is_rigid(rigid, 1e-12)
    assert rotation_angle_rad(rigid[:3, :3] @ yaw_rotation(-0.3)) < 1e-3


@pytest.mark.parametrize(
    "matrix", [np.full((4, 4), np.nan), np.zeros((4, 4)), np.diag([1.0, 1.0, -1.0, 1.0]), 1.1 * np.eye(4)]
)
def test_what_is_no_rigid_transform_is_no_pose(matrix):
    assert nearest_rigid(matrix) is None
