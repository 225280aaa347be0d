import numpy as np
import pytest
from hickory_stream.worlds.depth_camera import DepthCameraConfig, sensed_depth

FOCAL_PX = 381.0
ONLY_NOISE = DepthCameraConfig(dropout_share=0.0, disparity_step_px=1 / 4096)


def plane(depth_m):
    return np.full((200, 300), depth_m, dtype=np.float32), np.ones((200, 300), dtype=np.float32)


def test_noise_grows_with_the_square_of_the_depth():
    spread = {}
    for depth_m in (1.0, 2.0, 4.0):
        spread[depth_m] = np.nanstd(sensed_depth(*plane(depth_m), FOCAL_PX, ONLY_NOISE, np.random.default_rng(0)))
        # Error propagation through z = f b / d.
        expected = depth_m**2 / (FOCAL_PX * ONLY_NOISE.baseline_m) * ONLY_NOISE.disparity_sigma_px
        assert spread[depth_m] == pytest.approx(expected, rel=0.1)
    assert spread[4.0] / spread[1.0] == pytest.approx(16, rel=0.05)


def test_disparities_are_multiples_of_their_step():
    config = DepthCameraConfig()
    sensed = sensed_depth(*plane(2.5), FOCAL_PX, config, np.random.default_rng(0))
    steps = FOCAL_PX * config.baseline_m / sensed[np.isfinite(sensed)] / config.disparity_step_px
    assert np.abs(steps - np.round(steps)).max() < 1e-3


def test_patches_alone_lose_their_share():
    config = DepthCameraConfig(dropout_share=0.1)
    sensed = sensed_depth(*plane(2.0), FOCAL_PX, config, np.random.default_rng(0))
    assert np.isnan(sensed).mean() == pytest.approx(0.1, abs=0.005)


def test_nothing_is_reported_out_of_range_or_at_a_grazing_angle():
    depth, cosine = plane(2.0)
    depth[:, :50], depth[:, 50:100] = 0.2, 9.0
    cosine[:, 150:200] = 0.0
    sensed = sensed_depth(depth, cosine, FOCAL_PX, ONLY_NOISE, np.random.default_rng(0))
    for lost in (slice(0, 49), slice(51, 99), slice(150, 200)):
        assert np.isnan(sensed[:, lost]).all()
    assert np.isfinite(sensed[:, 205:]).all()


def test_a_near_thing_throws_a_stereo_shadow_to_its_left():
    depth, cosine = plane(4.0)
    depth[:, 150:] = 1.0
    config = DepthCameraConfig(dropout_share=0.0, disparity_sigma_px=0.0, edge_loss=0.0, flying_share=0.0)
    sensed = sensed_depth(depth, cosine, FOCAL_PX, config, np.random.default_rng(0))
    # f b (1 / 1 m - 1 / 4 m) = 34.3 pixels.
    assert np.isnan(sensed).sum(axis=1) == pytest.approx(34, abs=1)
    assert np.isnan(sensed[:, 120:150]).all()


def test_flying_pixels_lie_between_the_two_depths_of_an_edge():
    depth, cosine = plane(3.0)
    depth[:, :150] = 2.0
    config = DepthCameraConfig(dropout_share=0.0, disparity_sigma_px=0.0, edge_loss=0.0, flying_share=1.0)
    sensed = sensed_depth(depth, cosine, FOCAL_PX, config, np.random.default_rng(0))
    at_edge = sensed[:, 149:151]
    assert ((at_edge > 2.05) & (at_edge < 2.95)).mean() > 0.7
    assert np.isfinite(sensed[:, :148]).all()


def test_the_generator_alone_decides():
    one, same, other = (
        sensed_depth(*plane(2.0), FOCAL_PX, DepthCameraConfig(), np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    assert np.array_equal(one, same, equal_nan=True)
    assert not np.array_equal(one, other, equal_nan=True)


@pytest.mark.parametrize("depth_m", [1.0, 2.5, 5.0])
def test_the_stated_sensor_has_its_noise_steps_and_range(depth_m):
    config = DepthCameraConfig(dropout_share=0.0)
    sensor = config.sensor(FOCAL_PX)
    sensed = sensed_depth(*plane(depth_m), FOCAL_PX, config, np.random.default_rng(0))
    sigma_m = float(sensor.sigma_m(np.array([depth_m], dtype=np.float32))[0])
    assert np.nanstd(sensed) == pytest.approx(sigma_m, rel=0.12)
    steps = 1 / sensed[np.isfinite(sensed)] / sensor.step_per_m
    assert np.abs(steps - np.round(steps)).max() < 1e-2
    ends = np.array([[sensor.min_m - 0.05, sensor.max_m + 1.0]], dtype=np.float32)
    assert np.isnan(sensed_depth(ends, np.ones_like(ends), FOCAL_PX, config, np.random.default_rng(0))).all()
