from dataclasses import replace
import cv2
import numpy as np
import pytest
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, yaw_rotation
from hickory_stream.ports import NotRegistered, Registered
from hickory_stream.poses.camera_odometry import CameraOdometry
from hickory_stream.poses.visual_motion import VisualMotion, features_of
from hickory_stream.poses.voxel_map_odometry import VoxelMapOdometry
from hickory_stream.records import Frame, Scan
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
                stamp_ns=round(i * 1e8), frame="lidar", points=seen.astype(np.float32),
                times_s=times if name == "deskewed" else None,
            )  # fmt: skip
            found = each.register(scan)
        errors[name] = float(np.linalg.norm(found.start_from_sensor[:3, 3] - start[:3, 3]))
    assert errors["deskewed"] < 0.05


def _moved(velocity, seconds):
    return from_rotation_translation(yaw_rotation(seconds), velocity[:3, 3] * seconds)


CAMERA = Camera(width=320, height=240, fx=260.0, fy=260.0, cx=159.5, cy=119.5)
WALL_M, PX_PER_M = 2.0, 130.0


@pytest.fixture(scope="module")
def picture():
    """A painted wall of 8 by 4 metres, a pixel of it for a pixel of an image."""
    blots = np.random.default_rng(3).integers(0, 255, (65, 130, 3)).astype(np.uint8)
    return cv2.resize(blots, (int(8 * PX_PER_M), int(4 * PX_PER_M)), interpolation=cv2.INTER_CUBIC)


def before_wall(index, x_m, picture=None):
    """A camera at `x_m` along a bare or a painted wall."""
    pose, depth_m = np.eye(4), np.full((CAMERA.height, CAMERA.width), WALL_M, np.float32)
    pose[0, 3] = x_m
    rgb = np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)
    if picture is not None:
        shift = np.array([[1, 0, -PX_PER_M * (x_m + 0.5)], [0, 1, -60]])
        rgb = cv2.warpAffine(picture, shift, (CAMERA.width, CAMERA.height))
    return Frame(
        index=index, stamp_ns=index * 200_000_000, rgb=rgb, depth_m=depth_m, camera=CAMERA, world_from_camera=pose
    )


def sideways(found):
    return found.start_from_sensor[0, 3]


def test_colour_moves_along_a_wall_where_depth_slides(picture):
    by_both, by_depth = CameraOdometry(), CameraOdometry()
    steps = [0.02 * i * i for i in range(8)]
    both = [by_both.register(before_wall(i, x_m, picture)) for i, x_m in enumerate(steps)]
    bare = [by_depth.register(before_wall(i, x_m)) for i, x_m in enumerate(steps)]
    np.testing.assert_allclose([sideways(each) for each in both], steps, atol=0.01)
    assert [len(each.degenerate) for each in both] == [0] * len(steps)
    assert abs(sideways(bare[-1])) < 0.1, "constant velocity from a stand"
    assert len(bare[-1].degenerate) == 3, "two shifts and a turn"


def test_a_lost_camera_finds_its_place_in_its_own_map(picture):
    odometry = CameraOdometry()
    for i in range(12):
        odometry.register(before_wall(i, 0.2 * i, picture))
    dark = before_wall(12, 2.2)
    blank = odometry.register(replace(dark, depth_m=np.full_like(dark.depth_m, np.nan)))
    assert isinstance(blank, NotRegistered)
    again = odometry.register(before_wall(13, 0.35, picture))
    assert abs(sideways(again) - 0.35) < 0.02


def test_a_camera_finds_its_place_among_many_nearer_ones(picture):
    motion, places, elsewhere = VisualMotion(), np.tile(np.eye(4), (40, 1, 1)), features_of(before_wall(1, 6, picture))
    places[:, 1, 3] = 40.0 + np.arange(40)
    motion.placed(features_of(before_wall(0, 0.4, picture)), before_wall(0, 0.4).world_from_camera)
    for place in places:
        motion.placed(elsewhere, place)
    found = motion.found(features_of(before_wall(2, 0.5, picture)))
    np.testing.assert_allclose(found.start_from_camera[:3, 3], (0.5, 0, 0), atol=0.02)


def test_another_wall_is_no_known_place(picture):
    odometry = CameraOdometry()
    odometry.register(before_wall(0, 0.0, picture))
    found = odometry.register(before_wall(1, 0.0, picture[::-1, ::-1]))
    assert isinstance(found, NotRegistered) or len(found.degenerate) == 3


def nothing(frame):
    return replace(frame, rgb=np.zeros_like(frame.rgb), depth_m=np.full_like(frame.depth_m, np.nan))


def shirt(frame):
    folds = np.random.default_rng(frame.index).integers(0, 255, (24, 32, 3)).astype(np.uint8)
    rgb = cv2.resize(folds, (CAMERA.width, CAMERA.height))
    return replace(frame, rgb=rgb, depth_m=np.full_like(frame.depth_m, 0.6))


def dark(frame):
    return replace(frame, rgb=np.zeros_like(frame.rgb))


@pytest.mark.parametrize("seen", [nothing, shirt, dark], ids=["put down", "a person fills the view", "a dark corridor"])
def test_a_hidden_view_is_reported_and_the_camera_found_again(picture, seen):
    odometry = CameraOdometry()
    for i in range(10):
        odometry.register(before_wall(i, 0.1 * i, picture))
    hidden = [odometry.register(seen(before_wall(10 + i, 0.9, picture))) for i in range(10)]
    assert all(isinstance(each, NotRegistered) or len(each.degenerate) for each in hidden)
    again = [odometry.register(before_wall(20 + i, 0.4 + 0.1 * i, picture)) for i in range(3)]
    np.testing.assert_allclose([sideways(each) for each in again], [0.4, 0.5, 0.6], atol=0.02)


def test_a_camera_is_found_after_frames_stopped_for_a_minute(picture):
    odometry = CameraOdometry()
    for i in range(10):
        odometry.register(before_wall(i, 0.1 * i, picture))
    late = replace(before_wall(10, 0.4, picture), stamp_ns=62_000_000_000)
    assert abs(sideways(odometry.register(late)) - 0.4) < 0.02
