from functools import cache
import numpy as np
import pytest
from hickory_stream.geometry.rigid import from_rotation_translation, invert, yaw_rotation
from tools.benchmarks.alignment.covariance import WalkMap, squares_of
from tools.evaluation.simulated_maps.simulate import SimulationConfig, simulate_pair


@cache
def pair():
    return simulate_pair(SimulationConfig(num_objects=30, outliers=0.3), 4)


def poses():
    rng = np.random.default_rng(0)
    return np.array(
        [from_rotation_translation(yaw_rotation(rng.uniform(0, 6)), rng.uniform(-4, 4, 3)) for _ in range(20)]
    )


def walks(off_m):
    """The two maps of a pair; truth says that the second one lies `off_m` beside where it does."""
    true = poses()
    off = from_rotation_translation(np.eye(3), np.array([0.0, off_m, 0.0]))
    one = WalkMap(objects=pair().map_a, found=true, true=true)
    return one, WalkMap(objects=pair().map_b, found=invert(pair().a_from_b) @ off @ true, true=true)


@pytest.mark.parametrize(("off_m", "least", "most"), [(0.0, 0.0, 20.0), (0.3, 20.0, 1e4)])
def test_squares_are_small_where_truth_agrees(off_m, least, most):
    found = squares_of(*walks(off_m), seed=1, trials=4)
    assert len(found.squares) >= 2
    assert len(found.squares) + found.refused + found.wrong == 4
    assert least < min(found.squares) <= max(found.squares) < most


def test_a_bent_map_lies_where_the_poses_around_say():
    true = poses()
    found = true.copy()
    found[true[:, 0, 3] > 0, 0, 3] += 0.1
    walk = WalkMap(objects=pair().map_a, found=found, true=true)
    right = found[np.argmax(true[:, 0, 3]), :3, 3]
    assert walk.map_from_world(right, 1.0)[0, 3] > 0.05
    assert walk.map_from_world(np.array([-50.0, 0.0, 0.0]), 1.0)[0, 3] == pytest.approx(0.0, abs=0.03)
