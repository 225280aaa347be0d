import numpy as np
from scipy.spatial.transform import Rotation
from hickory_stream.alignment.registration import common_covariance, levelled, tilt_vector
from hickory_stream.geometry.rigid import from_rotation_translation, yaw_rotation

SIGMAS = np.radians([0.1, 0.5, 2.0, 10.0])


def turned(tilt_deg, azimuth_rad):
    axis = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    tilt = Rotation.from_rotvec(np.radians(tilt_deg) * axis).as_matrix()
    return from_rotation_translation(tilt @ yaw_rotation(0.7), np.array([1.0, 2.0, 3.0]))


def covariance(tilt_sigma_deg):
    return np.diag([np.radians(tilt_sigma_deg) ** 2] * 3 + [0.02**2] * 3)


def test_the_tilt_vector_is_the_turn_that_tilts_whatever_the_yaw():
    for azimuth in (0.3, 2.0, -1.4):
        expected = np.radians(12.0) * np.array([np.cos(azimuth), np.sin(azimuth)])
        assert np.allclose(tilt_vector(turned(12.0, azimuth)), expected)
    assert (tilt_vector(turned(0.0, 0.0)) == 0).all()


def test_a_tilt_within_noise_vanishes_and_a_clear_one_stays():
    doubtful = levelled(turned(0.5, 1.0), covariance(0.5), np.zeros(3), SIGMAS)
    clear = levelled(turned(5.0, 1.0), covariance(0.2), np.zeros(3), SIGMAS)
    assert doubtful.is_level
    assert np.linalg.norm(tilt_vector(doubtful.a_from_b)) < np.radians(0.3)
    assert not clear.is_level
    assert np.isclose(np.linalg.norm(tilt_vector(clear.a_from_b)), np.radians(5.0), rtol=0.02)


def test_an_unsure_tilt_leaves_what_else_is_known():
    for tilt_deg in (0.0, 0.6, 2.0):
        found = levelled(turned(tilt_deg, 0.4), covariance(0.6), np.zeros(3), SIGMAS)
        sigmas_deg = np.degrees(np.sqrt(np.diag(found.covariance)[:2]))
        assert (sigmas_deg > 0.05).all()
        assert (sigmas_deg < 0.8).all()
        assert np.allclose(np.diag(found.covariance)[2:], np.diag(covariance(0.6))[2:])


def test_common_errors_do_not_shrink_with_the_number_of_objects():
    rng = np.random.default_rng(0)
    few, many = rng.uniform(-3, 3, (8, 3)), rng.uniform(-3, 3, (200, 3))
    both = [common_covariance(p, p.mean(axis=0), (0.004, 0.008), 0.2) for p in (few, many)]
    assert all(np.allclose(np.sqrt(np.diag(c)[3:]), [0.004, 0.004, 0.008], rtol=0.2) for c in both)
