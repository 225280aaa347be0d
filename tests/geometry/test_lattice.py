import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hickory_stream.geometry.lattice import MESH_STEPS_PER_M, STEPS_PER_M, packed_points, points_of, unpacked_steps

STEPS = hnp.arrays(np.int32, st.tuples(st.integers(0, 20), st.just(3)), elements=st.integers(-(2**24) + 1, 2**24 - 1))


@given(STEPS, st.sampled_from([STEPS_PER_M, MESH_STEPS_PER_M]))
def test_points_at_steps_come_back_to_the_bit(steps, steps_per_m):
    points = points_of(steps, steps_per_m)
    data = packed_points(points, steps_per_m)
    assert len(data) == 12 * len(points)
    assert points_of(unpacked_steps(data, len(points)), steps_per_m).tobytes() == points.tobytes()


def test_steps_are_deltas_with_lowest_bytes_first():
    points = np.array([[1, -1, 300], [1, 0, 298]], np.float32) / np.float32(STEPS_PER_M)
    # 0, -1, 1, -2, ... as 0, 1, 2, 3, ...: x 1 and 0, y -1 and 1, z 300 and -2.
    assert packed_points(points) == bytes([2, 0, 1, 2, 600 % 256, 3, 0, 0, 0, 0, 600 // 256, 0, *(0,) * 12])


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -0.0, 512.0, -512.0, 1e-6])
def test_what_is_at_no_step_or_too_far_is_not_packed(value):
    points = np.zeros((3, 3), np.float32)
    assert packed_points(points) is not None
    points[1, 2] = value
    assert packed_points(points) is None
