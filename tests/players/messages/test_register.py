import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.rigid import from_rotation_translation, invert, rotation_from_quaternion
from players.messages.depth_registration import Registration, register_depth
from tests import player_scenes as scenes

DEPTH = Camera(width=320, height=240, fx=300.0, fy=300.0, cx=160.0, cy=120.0)
COLOR = Camera(width=320, height=240, fx=270.0, fy=272.0, cx=163.0, cy=116.0)
COLOR_FROM_DEPTH = from_rotation_translation(
    rotation_from_quaternion(0.01, -0.005, 0.003, 1.0), np.array([-0.034, 0.008, 0.003])
)


def _registered(depth_camera, color_camera):
    """Return the registered depth, and the depth that the colour camera would have measured (infinite = nothing)."""
    world_from_depth = scenes.pose_at(scenes.START_NS)
    depth_m = scenes.cast(depth_camera, world_from_depth)[1].astype(np.float32)
    depth_m[~np.isfinite(depth_m)] = np.nan
    registration = Registration(depth_camera=depth_camera, color_camera=color_camera, color_from_depth=COLOR_FROM_DEPTH)
    truth = scenes.cast(color_camera, world_from_depth @ invert(COLOR_FROM_DEPTH))[1]
    return register_depth(depth_m, registration), truth


@pytest.mark.parametrize("scale", [0.5, 1.0, 1.7])
def test_registered_depth_is_colours_own_and_has_no_holes(scale):
    seen, truth = _registered(DEPTH, COLOR.scaled(scale))
    both = np.isfinite(seen) & np.isfinite(truth)
    error = np.abs(seen - truth)[both]
    assert np.median(error) < 0.004
    assert (error < 0.05).mean() > 0.97
    height, width = seen.shape
    middle = seen[height // 4 : -height // 4, width // 4 : -width // 4]
    # What the depth camera did not see, behind the ball and the box, is a hole rightly.
    assert np.isnan(middle).mean() < 0.02


def test_the_nearer_of_two_surfaces_wins_whatever_the_order():
    camera = Camera(width=5, height=1, fx=10.0, fy=10.0, cx=2.0, cy=0.0)
    shifted = from_rotation_translation(np.eye(3), np.array([0.2, 0.0, 0.0]))
    registration = Registration(depth_camera=camera, color_camera=camera, color_from_depth=shifted)
    # At 1 m the shift is two pixels, at 2 m one: column 1 and column 2 both fall on column 3.
    depth_m = np.full((1, 5), np.nan, dtype=np.float32)
    depth_m[0, 1], depth_m[0, 2] = 1.0, 2.0
    assert register_depth(depth_m, registration)[0, 3] == pytest.approx(1.0)


def test_the_same_camera_keeps_depth_and_no_returns_stay_none():
    depth_m = np.ones((240, 320), dtype=np.float32)
    registration = Registration(depth_camera=DEPTH, color_camera=DEPTH, color_from_depth=np.eye(4))
    assert register_depth(depth_m, registration) is depth_m
    registration = Registration(depth_camera=DEPTH, color_camera=COLOR, color_from_depth=COLOR_FROM_DEPTH)
    assert np.isnan(register_depth(np.full((240, 320), np.nan, dtype=np.float32), registration)).all()


@given(st.floats(0.3, 8.0), st.integers(1, 4))
def test_a_wall_is_the_same_at_another_resolution(z, factor):
    wide = DEPTH.scaled(float(factor) / 2)
    registration = Registration(depth_camera=DEPTH, color_camera=wide, color_from_depth=np.eye(4))
    seen = register_depth(np.full((240, 320), z, dtype=np.float32), registration)
    np.testing.assert_allclose(seen, np.float32(z), rtol=1e-6)
