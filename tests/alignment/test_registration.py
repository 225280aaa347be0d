import numpy as np
from hypothesis import given
from scipy.spatial.transform import Rotation
from hickory_stream.alignment import registration
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from tests.strategies import rigid_transforms, seeds


@given(a_from_b=rigid_transforms(), seed=seeds)
def test_exact_points_give_the_exact_transform(a_from_b, seed):
    points_b = np.random.default_rng(seed).normal(size=(6, 3))
    found = registration.registered(apply(a_from_b, points_b), points_b, np.ones(6), is_level=False)
    assert np.allclose(found, a_from_b, atol=1e-6)


@given(seed=seeds)
def test_a_level_fit_is_the_best_turn_about_the_vertical(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    found = registration.registered(a, b, np.ones(5), is_level=True)
    assert registration.tilt_rad(found) < 1e-9
    best = ((a - apply(found, b)) ** 2).sum()
    for yaw in np.linspace(0, 2 * np.pi, 60):
        turned = b @ yaw_rotation(yaw).T
        assert best <= ((a - turned - (a - turned).mean(axis=0)) ** 2).sum() + 1e-9


def test_information_predicts_the_scatter_of_noisy_fits():
    rng = np.random.default_rng(2)
    a = rng.uniform(-3, 3, (9, 3))
    errors = []
    for _ in range(1500):
        found = registration.registered(a, a + rng.normal(0, 0.05, a.shape), np.ones(9), is_level=False)
        center = a.mean(axis=0)
        errors.append([*Rotation.from_matrix(found[:3, :3]).as_rotvec(), *(apply(found, center) - center)])
    predicted = np.linalg.inv(registration.information(a, np.full(9, 0.05), a.mean(axis=0)))
    measured = np.cov(np.array(errors).T)
    assert np.allclose(np.diag(measured), np.diag(predicted), rtol=0.15)


def test_transforms_differ_by_place_or_turn_of_the_overlap():
    far = np.array([10.0, 0.0, 0.0])
    turned = from_rotation_translation(yaw_rotation(np.radians(4.0)), np.zeros(3))
    limits = {"distance_m": 0.5, "angle_rad": np.radians(5.0)}
    assert not registration.differs(np.eye(4), turned, np.zeros(3), **limits)
    assert registration.differs(np.eye(4), turned, far, **limits)
    assert registration.differs(np.eye(4), invert(turned) @ invert(turned), np.zeros(3), **limits)


SIGMAS = np.radians([0.1, 0.5, 2.0, 10.0])


def tilted(tilt_deg, azimuth_rad):
    axis = np.array([np.cos(azimuth_rad), np.sin(azimuth_rad), 0.0])
    tilt = Rotation.from_rotvec(np.radians(tilt_deg) * axis).as_matrix()
    return from_rotation_translation(tilt @ yaw_rotation(0.7), np.array([1.0, 2.0, 3.0]))


def covariance(tilt_sigma_deg):
    return np.diag([np.radians(tilt_sigma_deg) ** 2] * 3 + [0.02**2] * 3)


def test_the_tilt_vector_is_the_turn_that_tilts_whatever_the_yaw():
    for azimuth in (0.3, 2.0, -1.4):
        expected = np.radians(12.0) * np.array([np.cos(azimuth), np.sin(azimuth)])
        assert np.allclose(registration.tilt_vector(tilted(12.0, azimuth)), expected)
    assert (registration.tilt_vector(tilted(0.0, 0.0)) == 0).all()


def test_a_tilt_within_noise_vanishes_and_a_clear_one_stays():
    doubtful = registration.levelled(tilted(0.5, 1.0), covariance(0.5), np.zeros(3), SIGMAS)
    clear = registration.levelled(tilted(5.0, 1.0), covariance(0.2), np.zeros(3), SIGMAS)
    assert doubtful.is_level
    assert np.linalg.norm(registration.tilt_vector(doubtful.a_from_b)) < np.radians(0.3)
    assert not clear.is_level
    assert np.isclose(np.linalg.norm(registration.tilt_vector(clear.a_from_b)), np.radians(5.0), rtol=0.02)


def test_an_unsure_tilt_leaves_what_else_is_known():
    for tilt_deg in (0.0, 0.6, 2.0):
        found = registration.levelled(tilted(tilt_deg, 0.4), covariance(0.6), np.zeros(3), SIGMAS)
        sigmas_deg = np.degrees(np.sqrt(np.diag(found.covariance)[:2]))
        assert (sigmas_deg > 0.05).all()
        assert (sigmas_deg < 0.8).all()
        assert np.allclose(np.diag(found.covariance)[2:], np.diag(covariance(0.6))[2:])


def test_common_errors_do_not_shrink_with_the_number_of_objects():
    rng = np.random.default_rng(0)
    few, many = rng.uniform(-3, 3, (8, 3)), rng.uniform(-3, 3, (200, 3))
    both = [registration.common_covariance(p, p.mean(axis=0), (0.004, 0.008), 0.2) for p in (few, many)]
    assert all(np.allclose(np.sqrt(np.diag(c)[3:]), [0.004, 0.004, 0.008], rtol=0.2) for c in both)
