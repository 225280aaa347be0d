import numpy as np
import pytest
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.shapes.reconstruct.symmetry import half_turn_of
from hickory_stream.shapes.reconstruct.tsdf import DepthView

CAMERA_WORLD = np.array([0.0, 0.0, 0.3])
AHEAD = np.array([2.0, 0.4])


def extruded(front, noise_m=0.0):
    """Return points of a front, given across and ahead of the middle, at heights of up to 0.3 m."""
    forward = AHEAD / np.linalg.norm(AHEAD)
    across = np.array([-forward[1], forward[0]])
    plane = AHEAD + front[:, :1] * across + front[:, 1:] * forward
    points = np.concatenate([np.column_stack([plane, np.full(len(plane), z)]) for z in np.linspace(0, 0.3, 12)])
    return points + np.random.default_rng(3).normal(size=points.shape) * noise_m


def arc(radius):
    angles = np.linspace(-np.pi / 2, np.pi / 2, 80)
    return radius * np.stack([np.sin(angles), -np.cos(angles)], axis=1)


@pytest.mark.parametrize("noise_m", [0.0, 0.005])
@pytest.mark.parametrize("radius", [0.04, 0.15])
def test_an_arc_is_turned_about_its_middle(radius, noise_m):
    turn = half_turn_of(extruded(arc(radius), noise_m), CAMERA_WORLD, [], 0.01)
    assert np.linalg.det(turn[:3, :3]) == pytest.approx(1)
    axis = turn[:2, 3] / 2
    assert np.linalg.norm(axis - AHEAD) < 0.12 * radius + 2 * noise_m


@pytest.mark.parametrize("yaw_deg", [0, 10, 25, 45])
def test_the_front_of_a_box_is_not_round(yaw_deg):
    yaw = np.deg2rad(yaw_deg)
    side = np.linspace(-0.15, 0.15, 60)
    faces = np.concatenate([np.stack([side, -0.15 + 0 * side], axis=1), np.stack([-0.15 + 0 * side, side], axis=1)])
    turned = faces @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    front = turned if yaw_deg else faces[:60]
    assert half_turn_of(extruded(front, 0.002), CAMERA_WORLD, [], 0.01) is None


def test_what_was_seen_through_behind_is_not_turned():
    points = extruded(arc(0.15))
    # From the side a camera sees a wall far behind where the turned half would be.
    pose = np.eye(4)
    pose[:3, :3] = np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    pose[:3, 3] = [AHEAD[0] + 0.15, AHEAD[1] - 1.5, 0.15]
    camera = Camera(width=160, height=120, fx=130, fy=130, cx=79.5, cy=59.5)
    view = DepthView(
        law=DepthSensor().law, depth_m=np.full((120, 160), 4.0, np.float32), mask=np.zeros((120, 160), bool),
        camera=camera, camera_from_world=invert(pose),
    )  # fmt: skip
    assert (apply(view.camera_from_world, points)[:, 2] > 0.5).all()
    assert half_turn_of(points, CAMERA_WORLD, [view], 0.01) is None


def test_points_above_the_camera_have_no_front():
    assert half_turn_of(np.array([[0.0, 0.0, 1.0]] * 30), CAMERA_WORLD, [], 0.01) is None
