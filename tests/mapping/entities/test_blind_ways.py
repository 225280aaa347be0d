import numpy as np
import pytest
from hickory_stream.geometry.rigid import compose, from_rotation_translation, yaw_rotation
from hickory_stream.mapping.entities.submaps import longer

EAST, TURNS = np.eye(6)[[3]], np.eye(6)[[2]]
STEP = from_rotation_translation(yaw_rotation(0.1), np.array([0.3, 0.4, 0.0]))


def test_path_length_adds_up_along_blind_directions_only():
    lengths, pose = None, np.eye(4)
    for directions in (EAST, EAST, TURNS, EAST[:0]):
        after = compose(pose, STEP)
        lengths = longer(lengths, directions, pose, after)
        pose = after
    assert lengths[3, 3] == pytest.approx(1.0)
    assert lengths[2, 2] == pytest.approx(0.1)
    assert np.count_nonzero(lengths) == 2


def test_a_slanted_direction_has_a_length_and_a_first_step_none():
    askew = np.array([[0.0, 0.0, 0.0, 0.6, 0.8, 0.0]])
    lengths = longer(None, askew, np.eye(4), STEP)
    assert lengths is not None
    assert np.allclose(lengths @ askew[0], 0.5 * askew[0])
    assert longer(None, EAST, None, STEP) is None
    assert longer(None, EAST[:0], np.eye(4), STEP) is None
