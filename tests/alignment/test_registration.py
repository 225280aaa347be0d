import numpy as np
from hypothesis import given
from scipy.spatial.transform import Rotation
from hickory_stream.alignment.registration import differs, information, registered, tilt_rad
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, yaw_rotation
from tests.strategies import rigid_transforms, seeds


@given(a_from_b=rigid_transforms(), seed=seeds)
def test_exact_points_give_the_exact_transform(a_from_b, seed):
    points_b = np.random.default_rng(seed).normal(size=(6, 3))
    found = registered(apply(a_from_b, points_b), points_b, np.ones(6), is_level=False)
    assert np.allclose(found, a_from_b, atol=1e-6)


@given(seed=seeds)
def test_a_level_fit_is_the_best_turn_about_the_vertical(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    found = registered(a, b, np.ones(5), is_level=True)
    assert tilt_rad(found) < 1e-9
    best = ((a - apply(found, b)) ** 2).sum()
    for yaw in np.linspace(0, 2 * np.pi, 60):
        turned = b @ yaw_rotation(yaw).T
        assert best <= ((a - turned - (a - turned).mean(axis=0)) ** 2).sum() + 1e-9


def test_information_predicts_the_scatter_of_noisy_fits():
    rng = np.random.default_rng(2)
    a = rng.uniform(-3, 3, (9, 3))
    errors = []
    for _ in range(1500):
        found = registered(a, a + rng.normal(0, 0.05, a.shape), np.ones(9), is_level=False)
        center = a.mean(axis=0)
        errors.append([*Rotation.from_matrix(found[:3, :3]).as_rotvec(), *(apply(found, center) - center)])
    predicted = np.linalg.inv(information(a, np.full(9, 0.05), a.mean(axis=0)))
    measured = np.cov(np.array(errors).T)
    assert np.allclose(np.diag(measured), np.diag(predicted), rtol=0.15)


def test_transforms_differ_by_place_or_turn_of_the_overlap():
    far = np.array([10.0, 0.0, 0.0])
    turned = from_rotation_translation(yaw_rotation(np.radians(4.0)), np.zeros(3))
    limits = {"distance_m": 0.5, "angle_rad": np.radians(5.0)}
    assert not differs(np.eye(4), turned, np.zeros(3), **limits)
    assert differs(np.eye(4), turned, far, **limits)
    assert differs(np.eye(4), invert(turned) @ invert(turned), np.zeros(3), **limits)
