import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.errors import RangeError
from hickory_stream.geometry.depth_sensor import DepthSensor, SensorConfig, sigma_at

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
