import numpy as np
import pytest
from players.profile import load_profile, profile_names


def sigma_m(profile, depth_m):
    return float(load_profile(profile, robot="acl_jackal").sensor.sigma_m(np.array([depth_m], dtype=np.float32))[0])


def test_a_zed_and_a_d455_err_as_their_makers_state():
    for name in ("zed", "nus_clb"):
        assert sigma_m(name, 3.0) < 0.01 * 3.0 and sigma_m(name, 15.0) < 0.05 * 15.0
    for name in ("realsense", "kimera_multi"):
        assert sigma_m(name, 2.0) == pytest.approx(4 * 0.08 / (425 * 0.095), rel=0.02)


@pytest.mark.parametrize("depth_m", [1.0, 2.0, 3.0, 4.0])
def test_a_kinect_is_as_noisy_as_was_measured(depth_m):
    # Axial noise by Nguyen et al. 2012, and steps of 2.8e-3 z2.
    measured = np.hypot(0.0012 + 0.0019 * (depth_m - 0.4) ** 2, 0.0028 * depth_m**2 / np.sqrt(12))
    for name in ("seven_scenes", "tum"):
        assert sigma_m(name, depth_m) == pytest.approx(measured, rel=0.15)


def test_every_profile_has_a_title_and_a_range_of_a_room():
    assert load_profile("kimera_multi", robot="thoth").title
    for name in profile_names():
        profile = load_profile(name, robot="acl_jackal")
        assert profile.title
        sensor = profile.sensor
        assert sensor.min_m <= 0.4
        assert sensor.max_m >= 5.0
