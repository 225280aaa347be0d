import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.shapes.fit.cell_shares import body_of, distance_bound, occupancies, occupancy
from hickory_stream.shapes.fit.quadric_lm import row_of
from tests.shapes.shape_fixtures import tangent_distance
from tests.strategies import rotations

_LOW, _HIGH = np.array([-9, -9, -9]), np.array([10, 10, 10])


def occupancies_one_by_one(row):
    """Return the same cell by cell: what follows a cell far away is as it is."""
    body = body_of(row)
    out = np.empty(_HIGH - _LOW, np.float32)
    for i, j in np.ndindex(*out.shape[:2]):
        k = 0
        while k < out.shape[2]:
            x, y, z = np.array([i, j, k]) + _LOW
            d = distance_bound(body, x, y, z)
            if abs(d) <= 0.5:
                d = max(tangent_distance(row, np.array([x, y, z]), 0.5), -0.5)
            end = k + 1 + int(max(abs(d) - 0.5, 0.0))
            out[i, j, k:end] = occupancy(d)
            k = end
    return out


@given(st.floats(0.1, 2.0), st.floats(0.1, 2.0), rotations(), st.tuples(*[st.floats(0.3, 8.0)] * 3))
def test_shares_of_a_block_are_those_of_each_cell(e1, e2, rotation, axes):
    row = row_of((e1, e2), np.array(axes), np.array([0.3, -0.6, 0.1]), rotation)
    assert np.array_equal(occupancies(row, _LOW, _HIGH), occupancies_one_by_one(row))


def test_a_box_fills_its_volume():
    filled = occupancies(row_of((0.1, 0.1), np.array([5.0, 3.0, 2.5]), np.zeros(3), np.eye(3)), _LOW, _HIGH)
    assert filled.dtype == np.float32
    assert abs(filled.sum() - 10 * 6 * 5) < 0.06 * 10 * 6 * 5
    assert (filled[4 + 9 - 1, 9, 9], filled[7 + 9, 9, 9]) == (1.0, 0.0)
