import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.shapes.fit import tangent_planes
from hickory_stream.shapes.fit.cell_shares import body_of, distance_bound, occupancies, occupancy
from hickory_stream.shapes.fit.quadric_lm import row_of
from tests.shapes.shape_fixtures import tangent_distance
from tests.strategies import rotations


@given(st.floats(1e-300, 1e300))
def test_a_quick_logarithm_is_good_to_twelve_digits(x):
    assert tangent_planes.quick_log(x) == pytest.approx(np.log(x), rel=1e-12, abs=1e-13)


@given(st.floats(-690.0, 690.0))
def test_a_quick_exponential_is_good_to_twelve_digits(x):
    assert tangent_planes.quick_exp(x) == pytest.approx(np.exp(x), rel=1e-12)


def row_with(e1, e2, rotation):
    return row_of((e1, e2), np.array([12.0, 7.0, 3.0]), np.array([1.0, -2.0, 0.5]), rotation)


@given(st.floats(0.1, 2.0), st.floats(0.1, 2.0), rotations(), st.integers(0, 200))
def test_distances_of_many_points_are_those_of_each(e1, e2, rotation, count):
    row = row_with(e1, e2, rotation)
    points = np.random.default_rng(count).uniform(-16, 16, (count, 3))
    wanted = [tangent_distance(row, point, np.inf) for point in points]
    np.testing.assert_allclose(tangent_planes.distances_of(row, points, np.inf), wanted, rtol=1e-9, atol=1e-9)


def test_a_deep_enough_point_gets_a_deep_enough_bound():
    row = row_with(0.5, 0.5, np.eye(3))
    assert (tangent_planes.distances_of(row, np.array([[1.0, -2.0, 0.5], [1.3, -2.0, 0.4]]), 0.5) < -0.5).all()


def test_a_growing_or_moving_sphere_changes_distances_equally():
    row = row_of((1.0, 1.0), np.full(3, 5.0), np.zeros(3), np.eye(3))
    points = np.random.default_rng(0).normal(size=(tangent_planes.BLOCK, 3)) * 4
    block = tangent_planes.new_block()
    (
        block[tangent_planes.X : tangent_planes.X + tangent_planes.BLOCK],
        block[tangent_planes.Y : tangent_planes.Y + tangent_planes.BLOCK],
        block[tangent_planes.Z : tangent_planes.Z + tangent_planes.BLOCK],
    ) = points.T
    tangent_planes.fill_distances(block, tangent_planes.BLOCK, row, np.inf)
    tangent_planes.fill_jacobian(block)
    jacobian = block[tangent_planes.JACOBIAN :].reshape(11, tangent_planes.BLOCK)
    outside = block[tangent_planes.DISTANCE : tangent_planes.DISTANCE + tangent_planes.BLOCK] > 0
    # All axes grown by a factor: a sphere's surface moves by its radius; moved along the ray, by as much.
    np.testing.assert_allclose(jacobian[2:5, outside].sum(axis=0), -np.linalg.norm(points[outside], axis=1), rtol=1e-9)
    rays = points[outside] / np.linalg.norm(points[outside], axis=1)[:, None]
    np.testing.assert_allclose((jacobian[5:8, outside].T * rays).sum(axis=1), -1.0, rtol=1e-9)


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
