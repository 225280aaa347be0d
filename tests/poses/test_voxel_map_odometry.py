import numpy as np
import pytest
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.ports import NotRegistered, Registered
from hickory_stream.poses.voxel_map_odometry import VoxelMapOdometry
from hickory_stream.records import Scan
from tools.worlds.corridor import CorridorConfig, corridor_scans

ROOM = CorridorConfig(length_m=7.0, width_m=5.0, margin_m=2.0, way_m=2.0, columns=360)
ENDLESS = CorridorConfig(length_m=60.0, margin_m=20.0, range_m=12.0, way_m=3.0, columns=360)
"""No end of it is in reach, so that nothing tells how far one has come."""


@pytest.fixture(scope="module")
def room():
    return corridor_scans(ROOM, seed=1)


@pytest.fixture(scope="module")
def corridor():
    return corridor_scans(ENDLESS, seed=1)


def end_error_m(found, walk):
    assert isinstance(found, Registered)
    true_end = compose(invert(walk[0][1]), walk[-1][1])
    return float(np.linalg.norm(found.start_from_sensor[:3, 3] - true_end[:3, 3]))


def test_a_room_is_followed_to_a_centimetre(room):
    odometry = VoxelMapOdometry("lidar")
    found = [odometry.register(scan) for scan, _ in room]
    assert end_error_m(found[-1], room) < 0.01
    assert [len(each.degenerate) for each in found if isinstance(each, Registered)] == [0] * len(room)


def test_the_information_is_that_of_the_errors(room):
    """Of 6 degrees of freedom, the squared error over its covariance is 6 on average; within a factor of three."""
    odometry = VoxelMapOdometry("lidar")
    squared, before = [], None
    for scan, truth in room:
        found = odometry.register(scan)
        assert isinstance(found, Registered) and found.information is not None
        if before is not None:
            off = compose(invert(compose(invert(before[1]), truth)), invert(before[0]), found.start_from_sensor)
            turn = 0.5 * np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]])
            error = np.concatenate([turn, off[:3, 3]])
            squared.append(float(error @ found.information @ error))
        before = (found.start_from_sensor, truth)
    assert 1.0 < float(np.median(squared)) < 18.0


def test_a_corridor_without_ends_is_declared_degenerate_along_it(corridor):
    odometry = VoxelMapOdometry("lidar")
    found = [odometry.register(scan) for scan, _ in corridor]
    declared = [each for each in found[1:] if isinstance(each, Registered) and len(each.degenerate)]
    assert len(declared) >= 0.9 * (len(found) - 1)
    for each in declared:
        assert each.information is not None
        for direction in each.degenerate:
            assert abs(direction[3]) > 0.95, "along x of the sensor, which looks down the corridor"
            assert abs(direction @ each.information @ direction) < 1e-6 * np.trace(each.information)


def test_along_a_degenerate_direction_the_prediction_moves(corridor):
    odometry = VoxelMapOdometry("lidar")
    found = NotRegistered(reason="no scan")
    for i, (scan, truth) in enumerate(corridor):
        step = compose(invert(corridor[i - 1][1]), truth) if i else None
        found = odometry.register(scan, step)
    assert end_error_m(found, corridor) < 0.1


def test_a_sensor_that_was_carried_away_is_lost_until_it_is_back(room):
    odometry = VoxelMapOdometry("lidar")
    for scan, _ in room[:10]:
        odometry.register(scan)
    away = from_rotation_translation(yaw_rotation(1.2), np.array([40.0, 0.0, 3.0]))
    scan = room[10][0]
    elsewhere = Scan(stamp_ns=scan.stamp_ns, frame="lidar", points=apply(away, scan.points).astype(np.float32))
    lost = odometry.register(elsewhere)
    assert isinstance(lost, NotRegistered)
    assert "expected" in lost.reason or "where motion leads" in lost.reason
    assert end_error_m(odometry.register(room[11][0]), room[:12]) < 0.02


def test_points_of_a_turning_sensor_are_straightened():
    """A sweep of a tenth of a second while the sensor turns at 1 rad/s and goes at 1 m/s."""
    still = corridor_scans(ROOM, seed=2)[0][0]
    velocity = from_rotation_translation(yaw_rotation(1.0), np.array([1.0, 0.0, 0.0]))
    odometry, blind = VoxelMapOdometry("lidar"), VoxelMapOdometry("lidar")
    rng = np.random.default_rng(1)
    errors = {}
    for name, each in (("deskewed", odometry), ("raw", blind)):
        for i in range(6):
            start = _moved(velocity, i * 0.1)
            times = rng.permutation(np.linspace(0.0, 0.1, len(still.points))).astype(np.float32)
            now = [
                compose(invert(_moved(velocity, i * 0.1 + float(bin_s))), np.eye(4)) for bin_s in np.arange(10) / 100
            ]
            points = still.points.astype(np.float64)
            seen = np.stack([apply(now[min(int(t * 100), 9)], p) for t, p in zip(times, points, strict=True)])
            scan = Scan(
                stamp_ns=round(i * 1e8),
                frame="lidar",
                points=seen.astype(np.float32),
                times_s=times if name == "deskewed" else None,
            )
            found = each.register(scan)
        assert isinstance(found, Registered)
        errors[name] = float(np.linalg.norm(found.start_from_sensor[:3, 3] - start[:3, 3]))
    assert errors["deskewed"] < 0.05


def _moved(velocity, seconds):
    return from_rotation_translation(yaw_rotation(seconds), velocity[:3, 3] * seconds)
