from dataclasses import replace
from functools import cache
import numpy as np
import pytest
from hickory_stream.box_scene import SceneBox, cast_scene, scene_pose
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.depth_sensor import DepthSensor
from hickory_stream.records import Frame
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth
from players.doctor.depth_bias import DepthBias, depth_bias
from players.doctor.depth_noise import DepthNoise, depth_noise, flat_patches

CAMERA = Camera(width=320, height=240, fx=190.0, fy=190.0, cx=159.5, cy=119.5)
CONFIG = DepthCameraConfig()
WALLS = (
    SceneBox(low=(-3.0, 2.2, 0.0), high=(3.0, 2.4, 2.6), rgb=(220, 220, 210)),
    SceneBox(low=(-3.0, -2.4, 0.0), high=(3.0, -2.2, 2.6), rgb=(220, 220, 210)),
    SceneBox(low=(-3.2, -2.4, 0.0), high=(-3.0, 2.4, 2.6), rgb=(200, 210, 220)),
    SceneBox(low=(-0.2, -0.2, 0.0), high=(0.2, 0.2, 0.5), rgb=(120, 80, 50)),
)


@cache
def frames(bias_m=0.0):
    """Return a few frames of a room as a stereo camera sees them, with a constant added to depth."""
    found = []
    for i in range(0, 30, 5):
        pose = scene_pose(i)
        pose[2, 3] += 0.6
        rgb, depth_m, _ = cast_scene(WALLS, CAMERA, pose)
        noisy = sensed_depth(depth_m, np.ones_like(depth_m), CAMERA.fx, CONFIG, np.random.default_rng(i))
        biased = noisy + np.float32(bias_m)
        found.append(Frame(index=i, stamp_ns=i, rgb=rgb, depth_m=biased, camera=CAMERA, world_from_camera=pose))
    return tuple(found)


def patches(bias_m=0.0):
    return [flat_patches(frame) for frame in frames(bias_m)]


def test_the_noise_of_the_camera_is_found_from_what_is_flat():
    sensor = CONFIG.sensor(CAMERA.fx)
    noise = depth_noise(patches())
    for z in (1.5, 2.5, 3.5):
        truth = float(sensor.sigma_m(np.array([z], dtype=np.float32))[0])
        assert noise.sigma_m(z) == pytest.approx(truth, rel=0.3)
    assert not noise.is_other_than(sensor)


@pytest.mark.parametrize("bias_m", [0.0, 0.05, -0.04])
def test_a_constant_added_to_depth_is_found_to_a_centimetre(bias_m):
    bias = depth_bias(patches(bias_m))
    assert bias.bias_m == pytest.approx(bias_m, abs=0.01)
    assert bias.is_off == (bias_m != 0)


def test_twice_the_noise_is_another_sensor_and_unsure_bias_none():
    noise = DepthNoise(noise_m=0.0, noise_per_m=0.001, num_patches=100, near_m=1.0, far_m=4.0)
    assert noise.is_other_than(DepthSensor(noise_per_m=0.0025))
    assert noise.is_other_than(DepthSensor(noise_per_m=0.0004, floor_m=0.0))
    assert not noise.is_other_than(DepthSensor(noise_per_m=0.0015))
    bias = DepthBias(bias_m=0.03, error_m=0.002, num_frames=9)
    assert bias.is_off
    assert not replace(bias, bias_m=0.015).is_off
    assert not replace(bias, error_m=0.02).is_off


def test_where_nothing_is_flat_nothing_is_said():
    frame = frames()[0]
    rough = np.random.default_rng(0).uniform(1.0, 4.0, frame.depth_m.shape).astype(np.float32)
    found = [flat_patches(replace(frame, depth_m=rough)) for _ in range(8)]
    assert depth_noise(found) is None
    assert depth_bias(found) is None
    empty = flat_patches(replace(frame, depth_m=np.full_like(rough, np.nan)))
    assert depth_noise([empty] * 8) is None
    assert depth_bias([]) is None
