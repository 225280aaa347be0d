import numpy as np
import pytest
from hickory_stream.geometry.rigid import (
    apply,
    compose,
    from_rotation_translation,
    invert,
    rotation_of_vector,
    rotation_vector,
)
from hickory_stream.poses.hand_eye import FLU_FROM_OPTICAL, hand_eye
from hickory_stream.poses.upright import LevelledPoses, up_in
from hickory_stream.records import Scan

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
    turn = rotation_vector(found.body_from_camera[:3, :3] @ TRUE[:3, :3].T)
    return np.concatenate([turn, found.body_from_camera[:3, 3] - TRUE[:3, 3]])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("outliers", [0, 8])
def test_a_free_motion_tells_all_six_numbers_within_three_sigma(seed, outliers):
    found = hand_eye(*motions("free", seed=seed, outliers=outliers))
    off = error(found)
    assert np.linalg.norm(off[3:]) < 0.01
    assert np.linalg.norm(off[:3]) < np.radians(0.3)
    assert found.open_names() == ()
    assert off @ np.linalg.inv(found.covariance) @ off < 30.0


def test_a_motion_on_a_plane_leaves_the_height_open():
    found = hand_eye(*motions("planar", seed=1))
    assert found.open_names() == ("up",)
    off = error(found)
    assert np.linalg.norm(off[3:5]) < 0.01
    assert np.linalg.norm(off[:3]) < np.radians(0.5)


def test_a_straight_path_leaves_place_and_roll_open():
    found = hand_eye(*motions("straight", seed=1))
    assert set(found.open_names()) == {"roll", "forward", "left", "up"}
    assert np.abs(error(found)[1:3]).max() < np.radians(0.5)


def test_what_is_open_stays_where_it_was_assumed():
    assumed = TRUE.copy()
    assumed[2, 3] += 0.1
    found = hand_eye(*motions("planar", seed=2), assumed)
    assert abs(found.body_from_camera[2, 3] - assumed[2, 3]) < 0.05


def test_an_assumption_is_doubted_only_where_motion_says_so():
    found = hand_eye(*motions("planar", seed=3))
    assert found.disagrees_with(TRUE) is None
    higher = TRUE.copy()
    higher[2, 3] += 0.5
    assert found.disagrees_with(higher) is None, "the height is open"
    assert found.disagrees_with(ALIGNED)[0] == pytest.approx(np.linalg.norm(TRUE[:2, 3]), abs=0.02)


def test_without_motion_nothing_is_said():
    still = [np.eye(4)] * 30
    found = hand_eye(still, still)
    assert "moved in 0 of 30" in found.reason


UP = np.array([0.0, 0.0, 1.0])


def room(*, has_floor):
    """Return points of two walls and a floor, with a centimetre of noise; z is up."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 3, 4000), rng.uniform(0, 2, 4000)
    surfaces = [np.column_stack([a, np.zeros(4000), b]), np.column_stack([np.zeros(4000), a, b])]
    if has_floor:
        surfaces.append(np.column_stack([a, rng.uniform(0, 3, 4000), np.zeros(4000)]))
    points = np.concatenate(surfaces)
    return points + 0.005 * rng.standard_normal(points.shape)


def scan_of(points):
    return Scan(stamp_ns=0, frame="camera", points=points.astype(np.float32))


@pytest.mark.parametrize("tilt", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.5), (-0.5, 0.1, 2.0)])
def test_up_is_found_to_a_degree_whatever_the_tilt_of_the_camera(tilt):
    tilted = from_rotation_translation(rotation_of_vector(np.array(tilt)), np.array([0.4, -0.2, 1.0]))
    found = up_in(scan_of(apply(tilted, room(has_floor=True))), UP)
    assert found is not None
    assert np.degrees(np.arccos(min(1.0, found @ tilted[:3, 2]))) < 1.0


def test_walls_alone_or_a_cloud_without_surfaces_do_not_tell():
    cloud = np.random.default_rng(1).normal(0.0, 1.0, (5000, 3))
    assert [up_in(scan_of(points), UP) for points in (room(has_floor=False), cloud, cloud[:50])] == [None] * 3


@pytest.mark.parametrize(("has_floor", "most_deg"), [(True, 1.5), (False, 9.0)])
def test_odometry_that_tilts_stays_upright_over_a_floor(has_floor, most_deg):
    levelled, tilted = LevelledPoses(), np.eye(4)
    points = room(has_floor=has_floor)
    for i in range(121):
        pose = levelled.placed(np.eye(4), tilted, scan_of(apply(invert(truly(i)), points)))
        tilted = tilted @ invert(truly(i)) @ truly(i + 1) @ turned(0.03)
    off_deg = np.degrees(np.arccos(pose[2, :3] @ truly(120)[2, :3]))
    assert off_deg < most_deg
    assert has_floor or off_deg > 3.0, "nothing else tells"


def truly(i):
    return from_rotation_translation(rotation_of_vector(np.array([0.0, 0.0, 0.01 * i])), np.array([1.0, 1.0, 1.0]))


def turned(deg):
    return from_rotation_translation(rotation_of_vector(np.array([np.radians(deg), 0.0, 0.0])), np.zeros(3))
