import numpy as np
import pytest
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert, rotation_of_vector
from hickory_stream.poses.upright import LevelledPoses, up_in
from hickory_stream.records import Scan

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


def test_walls_alone_do_not_tell():
    assert up_in(scan_of(room(has_floor=False)), UP) is None


def test_a_cloud_without_surfaces_does_not_tell():
    points = np.random.default_rng(1).normal(0.0, 1.0, (5000, 3))
    assert up_in(scan_of(points), UP) is None
    assert up_in(scan_of(points[:50]), UP) is None


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
