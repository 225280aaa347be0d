from functools import partial
import numpy as np
import pytest
from hickory_stream.geometry.rigid import compose, invert, is_rigid
from hickory_stream.ports import NotRegistered, Registered
from hickory_stream.poses.choose import make_odometry
from hickory_stream.records import Scan
from tests.examples.dead_reckoning import DeadReckoning
from tools.worlds.corridor import CorridorConfig, corridor_scans

ROOM = CorridorConfig(length_m=7.0, width_m=5.0, margin_m=2.0, way_m=1.5, beams=16, columns=360)
WALK = corridor_scans(ROOM, seed=3)
MADE = {
    "example": DeadReckoning,
    "small_gicp": partial(make_odometry, "lidar", "small_gicp"),
    "kiss-icp": partial(make_odometry, "lidar", "kiss-icp"),
}


@pytest.fixture(params=sorted(MADE))
def make(request):
    return MADE[request.param]


def step(i):
    return compose(invert(WALK[i - 1][1]), WALK[i][1]) if i else None


def walked(odometry):
    return [odometry.register(scan, step(i)) for i, (scan, _) in enumerate(WALK)]


def test_poses_follow_the_walk_with_directions_and_covariance(make):
    found = walked(make())
    assert all(isinstance(each, Registered) for each in found)
    poses = [each.start_from_sensor for each in found]
    np.testing.assert_array_equal(poses[0], np.eye(4))
    assert all(is_rigid(pose) for pose in poses)
    assert [each.stamp_ns for each in found] == [scan.stamp_ns for scan, _ in WALK]
    true_end = compose(invert(WALK[0][1]), WALK[-1][1])
    # Bare walls hold KISS-ICP back.
    assert np.linalg.norm(poses[-1][:3, 3] - true_end[:3, 3]) < 0.4
    for each in found:
        np.testing.assert_allclose(np.linalg.norm(each.degenerate, axis=1), 1.0, atol=1e-9)
        if each.information is not None:
            np.testing.assert_allclose(each.information, each.information.T)
            assert np.linalg.eigvalsh(each.information).min() >= -1e-6 * max(1.0, np.abs(each.information).max())


def test_the_same_scans_give_the_same_poses_to_the_last_bit(make):
    first, second = walked(make()), walked(make())
    for a, b in zip(first, second, strict=True):
        assert isinstance(a, Registered) and isinstance(b, Registered)
        assert a.start_from_sensor.tobytes() == b.start_from_sensor.tobytes()


def test_a_scan_of_nothing_is_refused_and_changes_nothing(make):
    empty = Scan(stamp_ns=WALK[4][0].stamp_ns + 1, frame="lidar", points=np.empty((0, 3), dtype=np.float32))
    plain, disturbed = make(), make()
    for i, (scan, _) in enumerate(WALK):
        expected = plain.register(scan, step(i))
        found = disturbed.register(scan, step(i))
        if i == 4:
            refused = disturbed.register(empty)
            assert isinstance(refused, NotRegistered) and refused.reason
        assert isinstance(found, Registered) and isinstance(expected, Registered)
        assert found.start_from_sensor.tobytes() == expected.start_from_sensor.tobytes()
