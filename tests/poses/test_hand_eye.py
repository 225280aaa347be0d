import numpy as np
import pytest
from numpy.typing import NDArray
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    rotation_of_vector,
    rotation_vector,
)
from hickory_stream.poses.hand_eye import FLU_FROM_OPTICAL, HandEye, NoHandEye, hand_eye

Motions = tuple[list[NDArray[np.float64]], list[NDArray[np.float64]]]

TRUE = from_rotation_translation(
    rotation_of_vector(np.array([0.05, 0.1, -0.08])) @ FLU_FROM_OPTICAL, np.array([0.3, -0.1, 0.25])
)
ALIGNED = from_rotation_translation(FLU_FROM_OPTICAL, np.zeros(3))


def motions(kind, *, seed, count=60, outliers=0):
    """A walk in all directions ("free"), on a plane, or straight on; with noise of 3 mm and a tenth of a degree."""
    rng = np.random.default_rng(seed)
    bodies, cameras = [], []
    for i in range(count):
        turn = rng.normal(0.0, 0.3, 3) * {"free": (1, 1, 1), "planar": (0, 0, 1), "straight": (0, 0, 0)}[kind]
        way = np.array([rng.uniform(0.1, 0.4), 0.0, 0.0]) + (rng.normal(0.0, 0.05, 3) if kind == "free" else 0.0)
        body = from_rotation_translation(rotation_of_vector(np.asarray(turn)), way)
        noise = from_rotation_translation(rotation_of_vector(rng.normal(0, 0.002, 3)), rng.normal(0, 0.003, 3))
        camera = compose(invert(TRUE), body, TRUE, noise)
        if i < outliers:
            camera = compose(camera, from_rotation_translation(np.eye(3), np.array([0.5, 0.0, 0.0])))
        bodies.append(body)
        cameras.append(camera)
    return bodies, cameras


def error(found):
    assert isinstance(found, HandEye)
    turn = rotation_vector(found.body_from_camera[:3, :3] @ TRUE[:3, :3].T)
    return np.concatenate([turn, found.body_from_camera[:3, 3] - TRUE[:3, 3]])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("outliers", [0, 8])
def test_a_free_motion_tells_all_six_numbers_within_three_sigma(seed, outliers):
    found = hand_eye(*motions("free", seed=seed, outliers=outliers))
    assert isinstance(found, HandEye)
    off = error(found)
    assert np.linalg.norm(off[3:]) < 0.01
    assert np.linalg.norm(off[:3]) < np.radians(0.3)
    assert found.open_names() == ()
    assert off @ np.linalg.inv(found.covariance) @ off < 30.0


def test_a_motion_on_a_plane_leaves_the_height_open():
    found = hand_eye(*motions("planar", seed=1))
    assert isinstance(found, HandEye)
    assert found.open_names() == ("up",)
    off = error(found)
    assert np.linalg.norm(off[3:5]) < 0.01
    assert np.linalg.norm(off[:3]) < np.radians(0.5)


def test_a_straight_path_leaves_place_and_roll_open():
    found = hand_eye(*motions("straight", seed=1))
    assert isinstance(found, HandEye)
    assert set(found.open_names()) == {"roll", "forward", "left", "up"}
    assert np.abs(error(found)[1:3]).max() < np.radians(0.5)


def test_what_is_open_stays_where_it_was_assumed():
    assumed = TRUE.copy()
    assumed[2, 3] += 0.1
    found = hand_eye(*motions("planar", seed=2), assumed)
    assert isinstance(found, HandEye)
    assert abs(found.body_from_camera[2, 3] - assumed[2, 3]) < 0.05


def test_an_assumption_is_doubted_only_where_motion_says_so():
    found = hand_eye(*motions("planar", seed=3))
    assert isinstance(found, HandEye)
    assert found.disagrees_with(TRUE) is None
    higher = TRUE.copy()
    higher[2, 3] += 0.5
    assert found.disagrees_with(higher) is None, "the height is open"
    assert found.disagrees_with(ALIGNED)[0] == pytest.approx(np.linalg.norm(TRUE[:2, 3]), abs=0.02)


def test_without_motion_nothing_is_said():
    still = [np.eye(4)] * 30
    found = hand_eye(still, still)
    assert isinstance(found, NoHandEye)
    assert "moved in 0 of 30" in found.reason
