import numpy as np
import pytest
from hickory_stream.geometry.rigid import is_rigid
from hickory_stream.worlds.room import furnished_room
from hickory_stream.worlds.scene import part_boxes
from hickory_stream.worlds.trajectory import WalkConfig, camera_rotation, walk_round


@pytest.fixture(scope="module", params=[0, 1, 2])
def walk(request):
    world = furnished_room(request.param)
    return world, walk_round(world, 20.0, WalkConfig(clearance_m=0.25), np.random.default_rng(request.param))


def test_the_walk_keeps_its_speed_and_turns_slowly(walk):
    _, trajectory = walk
    step_s = np.diff(trajectory.times_s)
    poses = trajectory.world_from_camera
    speed = np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1) / step_s
    assert speed.min() > 0.4
    assert speed.max() < 0.6
    cosine = (np.einsum("nij,nij->n", poses[1:, :3, :3], poses[:-1, :3, :3]) - 1) / 2
    assert (np.degrees(np.arccos(np.clip(cosine, -1, 1))) / step_s).max() < 45


def test_the_camera_stays_at_eye_height_and_clear_of_every_part(walk):
    world, trajectory = walk
    eyes = trajectory.world_from_camera[:, :3, 3]
    assert eyes[:, 2].min() > 1.2
    assert eyes[:, 2].max() < 1.5
    for item in world.objects:
        for box in part_boxes(item.model, item.world_from_object):
            level = np.column_stack([eyes[:, :2], np.full(len(eyes), box.center[2])])
            assert not box.contains(level, margin_m=0.15).any()


def test_every_pose_is_rigid_and_looks_slightly_down(walk):
    _, trajectory = walk
    for world_from_camera in trajectory.world_from_camera[::50]:
        assert is_rigid(world_from_camera)
        assert -0.6 < world_from_camera[2, 2] < 0.0
        assert world_from_camera[2, 1] < -0.8


def test_a_room_without_enough_clearance_has_no_walk():
    answer = walk_round(furnished_room(0), 5.0, WalkConfig(clearance_m=5.0), np.random.default_rng(0))
    assert 0.0 <= answer.clearance_m < 5.0


def test_a_level_camera_of_yaw_zero_looks_along_x_with_y_down():
    expected = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    assert camera_rotation(0.0, 0.0, 0.0) == pytest.approx(expected)
