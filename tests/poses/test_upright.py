import numpy as np
import pytest
from hickory_stream.geometry.rigid import apply, from_rotation_translation, rotation_of_vector
from hickory_stream.poses.upright import up_in
from hickory_stream.records import Scan

UP = np.array([0.0, 0.0, 1.0])


def room(*, has_floor: bool) -> np.ndarray:
    """Return points of two walls and a floor, with a centimetre of noise; z is up."""
    rng = np.random.default_rng(0)
    a, b = rng.uniform(0, 3, 4000), rng.uniform(0, 2, 4000)
    surfaces = [np.column_stack([a, np.zeros(4000), b]), np.column_stack([np.zeros(4000), a, b])]
    if has_floor:
        surfaces.append(np.column_stack([a, rng.uniform(0, 3, 4000), np.zeros(4000)]))
    points = np.concatenate(surfaces)
    return points + 0.005 * rng.standard_normal(points.shape)


def scan_of(points: np.ndarray) -> Scan:
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
