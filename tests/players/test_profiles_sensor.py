import numpy as np
import pytest
from players.profile import load_profile, profile_names


def sigma_m(profile, depth_m):
    return float(load_profile(profile, robot="acl_jackal").sensor.sigma_m(np.array([depth_m], dtype=np.float32))[0])


def test_a_zed_is_within_the_accuracy_that_its_maker_states():
    for name in ("zed", "nus_clb"):
        assert sigma_m(name, 3.0) < 0.01 * 3.0
        assert sigma_m(name, 15.0) < 0.05 * 15.0


@pytest.mark.parametrize("depth_m", [1.0, 2.0, 3.0, 4.0])
def test_a_kinect_is_as_noisy_as_was_measured(depth_m):
    # Axial noise by Nguyen et al. 2012, and steps of 2.8e-3 z2.
    measured = np.hypot(0.0012 + 0.0019 * (depth_m - 0.4) ** 2, 0.0028 * depth_m**2 / np.sqrt(12))
    for name in ("seven_scenes", "tum"):
        assert sigma_m(name, depth_m) == pytest.approx(measured, rel=0.15)


def test_a_d455_errs_by_pixels_over_focal_length_and_baseline():
    for name in ("realsense", "kimera_multi"):
        assert sigma_m(name, 2.0) == pytest.approx(4 * 0.08 / (425 * 0.095), rel=0.02)


def test_every_profile_has_a_range_in_which_a_room_lies():
    for name in profile_names():
        sensor = load_profile(name, robot="acl_jackal").sensor
        assert sensor.min_m <= 0.4
        assert sensor.max_m >= 5.0
