from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.box_scene import SCENE_BOXES, cast_scene, scene_pose
from hickory_stream.geometry.camera import Camera
from hickory_stream.records import Frame
from players.doctor.depth_color_alignment import border_scores, color_alignment
from players.messages.depth_registration import Registration, register_depth

CAMERA = Camera(width=480, height=360, fx=420.0, fy=420.0, cx=239.5, cy=179.5)


SHADES = np.array([(150, 145, 140), *(box.rgb for box in SCENE_BOXES)], dtype=np.float64)


@pytest.fixture(scope="module")
def frames():
    """Six views of three plain boxes, with noise of the light."""
    rng = np.random.default_rng(3)
    made = []
    for i in range(6):
        _, depth_m, instances = cast_scene(SCENE_BOXES, CAMERA, scene_pose(3 * i))
        noisy = np.clip(SHADES[instances] + rng.normal(0.0, 4.0, (360, 480, 3)), 0, 255).astype(np.uint8)
        known = {"index": i, "stamp_ns": i, "camera": CAMERA, "world_from_camera": scene_pose(3 * i)}
        made.append(Frame(rgb=noisy, depth_m=depth_m, **known))
    return made


def agreement(frames):
    return color_alignment([scores for frame in frames if (scores := border_scores(frame)) is not None])


def registered(frame, x_m, y_m):
    """The frame as a calibration registers it that has the colour camera in a wrong place."""
    color_from_depth = np.eye(4)
    color_from_depth[:2, 3] = x_m, y_m
    registration = Registration(depth_camera=CAMERA, color_camera=CAMERA, color_from_depth=color_from_depth)
    return replace(frame, depth_m=register_depth(frame.depth_m, registration))


def test_colour_on_depth_and_edges_all_over_are_not_off(frames):
    found = agreement(frames)
    assert not found.is_off
    assert np.hypot(*found.offset_m) <= 0.0101
    striped = [replace(frame, rgb=cast_scene(SCENE_BOXES, CAMERA, frame.world_from_camera)[0]) for frame in frames]
    assert not agreement(striped).is_off


@pytest.mark.parametrize(("x_m", "y_m"), [(0.025, 0.0), (-0.03, 0.0), (0.02, -0.02)])
def test_a_shifted_colour_camera_is_reported_with_the_shift(frames, x_m, y_m):
    found = agreement([registered(frame, x_m, y_m) for frame in frames])
    assert found.is_off
    # Depth was put too far to the right: colour is found to its left.
    np.testing.assert_allclose(found.offset_m, (-x_m, -y_m), atol=0.0101)
    assert found.num_frames == len(frames)


def test_holes_beside_borders_as_in_stereo_change_nothing(frames):
    rng = np.random.default_rng(5)
    torn = []
    for frame in frames:
        depth = registered(frame, 0.025, 0.0).depth_m.copy()
        depth[rng.random(depth.shape) < 0.3] = np.nan
        torn.append(replace(frame, depth_m=depth))
    assert agreement(torn).is_off


COARSE = Camera(width=480, height=360, fx=90.0, fy=90.0, cx=239.5, cy=179.5)


@pytest.mark.parametrize("blind", [
    lambda frame: replace(frame, rgb=np.zeros_like(frame.rgb)),
    lambda frame: replace(frame, depth_m=np.full_like(frame.depth_m, 2.0)),
    lambda frame: replace(frame, camera=COARSE),
], ids=["black", "flat", "coarse"])  # fmt: skip
def test_where_nothing_tells_or_frames_are_few_nothing_is_said(frames, blind):
    assert agreement([blind(frame) for frame in frames]) is None
    assert agreement(frames[:3]) is None
