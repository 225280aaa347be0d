import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.errors import RangeError
from hickory_stream.geometry.camera import Camera, backproject, project
from hickory_stream.geometry.depth_sensor import DepthSensor, SensorConfig, sigma_at
from tests.strategies import cameras, seeds


def rays(camera, pixels):
    """Directions (x, y, 1) through pixel coordinates, by the inverse of the intrinsic matrix."""
    return np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(camera.K).T


@given(cameras(), seeds)
def test_projecting_the_points_of_a_depth_image_gives_its_pixels(camera, seed):
    depth = np.random.default_rng(seed).uniform(0.2, 8, (camera.height, camera.width)).astype(np.float32)
    points = backproject(depth, camera)
    y, x = np.mgrid[: camera.height, : camera.width]
    assert np.allclose(project(points, camera), np.stack([x, y], axis=-1), atol=2e-3)
    assert np.array_equal(points[..., 2], depth)


@given(cameras())
def test_a_pixel_without_depth_has_no_point(camera):
    depth = np.ones((camera.height, camera.width), dtype=np.float32)
    depth[2, 3] = np.nan
    points = backproject(depth, camera)
    assert np.isnan(points[2, 3]).all()
    assert np.isfinite(np.delete(points.reshape(-1, 3), 2 * camera.width + 3, axis=0)).all()


def test_projection_uses_the_intrinsics_and_drops_points_behind():
    camera = Camera(width=64, height=48, fx=50, fy=60, cx=31, cy=23)
    assert np.allclose(project(np.array([[0.5, -0.25, 2.0]]), camera), [[31 + 12.5, 23 - 7.5]])
    assert np.isnan(project(np.array([[0.1, 0.1, 0.0], [0.1, 0.1, -1.0]]), camera)).all()


@given(cameras(), st.sampled_from([0.25, 0.5, 0.75, 1.0, 2.0, 3.0]))
def test_a_scaled_camera_sees_the_same_rays(camera, factor):
    scaled = camera.scaled(factor)
    # Shares of the image's extent, whose border is half a pixel outside the outermost pixel centres.
    shares = np.array([[0, 0], [1, 0], [0, 1], [1, 1], [0.3, 0.6]])
    pixels, scaled_pixels = (shares * (c.width, c.height) - 0.5 for c in (camera, scaled))
    assert np.allclose(rays(camera, pixels), rays(scaled, scaled_pixels), atol=1e-9)
    assert (scaled.width, scaled.height) == (round(camera.width * factor), round(camera.height * factor))


@given(cameras(), st.data())
def test_a_cropped_camera_sees_the_rays_of_its_pixels(camera, data):
    x0, y0 = data.draw(st.integers(0, camera.width - 1)), data.draw(st.integers(0, camera.height - 1))
    x1, y1 = data.draw(st.integers(x0 + 1, camera.width)), data.draw(st.integers(y0 + 1, camera.height))
    depth = np.linspace(0.5, 3, camera.width * camera.height, dtype=np.float32).reshape(camera.height, camera.width)
    cropped = camera.cropped(x0, y0, x1, y1)
    assert np.allclose(backproject(depth, camera)[y0:y1, x0:x1], backproject(depth[y0:y1, x0:x1], cropped), atol=1e-5)


@pytest.mark.parametrize(
    "wrong", [{"width": 0}, {"height": -1}, {"fx": 0.0}, {"fy": -5.0}, {"fx": np.nan}, {"cx": np.inf}], ids=str
)
def test_a_camera_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match=r"camera of|focal lengths"):
        Camera(**{"width": 4, "height": 4, "fx": 5.0, "fy": 5.0, "cx": 2.0, "cy": 2.0, **wrong})


KINECT = DepthSensor(noise_per_m=0.0019, noise_m=0.0012)


def depths(*values):
    return np.array([values], dtype=np.float32)


def test_noise_grows_with_the_square_of_depth_where_it_is_known():
    sensor = DepthSensor(noise_per_m=0.0025, floor_m=0.001)
    np.testing.assert_allclose(sensor.sigma_m(depths(0.2, 1.0, 2.0, 4.0)), [[0.001, 0.0025, 0.01, 0.04]], rtol=1e-6)
    np.testing.assert_allclose(KINECT.sigma_m(depths(1.0, 2.0)), [[0.0031, 0.0088]], rtol=1e-6)
    assert np.isnan(DepthSensor().sigma_m(depths(np.nan))).all()


def test_a_step_of_disparity_adds_its_uniform_noise():
    # 1/8 pixel at a focal length of 400 pixels and a baseline of 5 cm, as good as no other noise.
    sensor = DepthSensor(noise_per_m=0.0, step_per_m=0.125 / (400 * 0.05))
    z = np.linspace(1.0, 3.0, 200_001)
    steps = np.round(1 / z / sensor.step_per_m) * sensor.step_per_m
    errors = (1 / steps - z) / z**2
    assert errors.std() == pytest.approx(sensor.spread_per_m, rel=0.02)


@given(st.floats(0.1, 20.0), st.floats(0, 0.1), st.floats(0, 0.1), st.floats(0, 0.01), st.floats(0, 0.01))
def test_compiled_code_has_the_same_law(z, quadratic, constant, floor, step):
    sensor = DepthSensor(noise_per_m=quadratic, noise_m=constant, floor_m=floor, step_per_m=step)
    assert sigma_at(z, sensor.law) == pytest.approx(float(sensor.sigma_m(depths(z))[0, 0]), rel=1e-5, abs=1e-9)


def test_out_of_range_is_no_return_and_a_bias_is_taken_off():
    depth = depths(0.3, 1.0, 5.0, np.nan)
    assert DepthSensor(min_m=0).returns(depth) is depth
    assert np.isnan(DepthSensor().returns(depths(0.1))).all()
    sensor = DepthSensor(min_m=0.5, max_m=4.0, bias_m=0.05)
    np.testing.assert_allclose(sensor.returns(depth), [[np.nan, 0.95, np.nan, np.nan]], rtol=1e-6)
    assert np.isnan(DepthSensor(bias_m=0.5).returns(depths(0.3))).all()


def test_edges_scale_with_images_and_settings_override_the_log():
    assert [DepthSensor(edge_rad=0.0045).edge_px(focal_px) for focal_px in (95, 349, 525, 1047)] == [0, 2, 2, 5]
    assert SensorConfig().over(KINECT) is KINECT
    assert SensorConfig(noise_m=0.0).over(KINECT) == DepthSensor(noise_per_m=0.0019, noise_m=0.0)


def test_depth_is_sure_to_a_length_as_far_as_its_law_says():
    assert DepthSensor(noise_per_m=0.0025).reach_m(0.0625) == pytest.approx(5.0)
    assert DepthSensor(noise_per_m=0.0025, max_m=3.0).reach_m(0.0625) == 3.0
    assert DepthSensor(noise_per_m=0.0, noise_m=0.02, max_m=4.0).reach_m(0.05) == 4.0
    assert DepthSensor(noise_m=0.1).reach_m(0.05) == 0.0


def test_a_range_that_ends_before_it_begins_is_refused():
    with pytest.raises(RangeError, match="min_m is 3; expected at most max_m, 2"):
        DepthSensor(min_m=3, max_m=2)
