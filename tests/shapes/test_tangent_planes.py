import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.shapes.fit.quadric_lm import row_of
from hickory_stream.shapes.fit.tangent_planes import (
    BLOCK,
    DISTANCE,
    JACOBIAN,
    X,
    Y,
    Z,
    distances_of,
    fill_distances,
    fill_jacobian,
    new_block,
    quick_exp,
    quick_log,
)
from tests.shapes.shape_fixtures import tangent_distance
from tests.strategies import rotations


@given(st.floats(1e-300, 1e300))
def test_a_quick_logarithm_is_good_to_twelve_digits(x):
    assert quick_log(x) == pytest.approx(np.log(x), rel=1e-12, abs=1e-13)


@given(st.floats(-690.0, 690.0))
def test_a_quick_exponential_is_good_to_twelve_digits(x):
    assert quick_exp(x) == pytest.approx(np.exp(x), rel=1e-12)


def row_with(e1, e2, rotation):
    return row_of((e1, e2), np.array([12.0, 7.0, 3.0]), np.array([1.0, -2.0, 0.5]), rotation)


@given(st.floats(0.1, 2.0), st.floats(0.1, 2.0), rotations(), st.integers(0, 200))
def test_distances_of_many_points_are_those_of_each(e1, e2, rotation, count):
    row = row_with(e1, e2, rotation)
    points = np.random.default_rng(count).uniform(-16, 16, (count, 3))
    wanted = [tangent_distance(row, point, np.inf) for point in points]
    np.testing.assert_allclose(distances_of(row, points, np.inf), wanted, rtol=1e-9, atol=1e-9)


def test_a_deep_enough_point_gets_a_deep_enough_bound():
    row = row_with(0.5, 0.5, np.eye(3))
    assert (distances_of(row, np.array([[1.0, -2.0, 0.5], [1.3, -2.0, 0.4]]), 0.5) < -0.5).all()


def test_a_growing_or_moving_sphere_changes_distances_equally():
    row = row_of((1.0, 1.0), np.full(3, 5.0), np.zeros(3), np.eye(3))
    points = np.random.default_rng(0).normal(size=(BLOCK, 3)) * 4
    block = new_block()
    block[X : X + BLOCK], block[Y : Y + BLOCK], block[Z : Z + BLOCK] = points.T
    fill_distances(block, BLOCK, row, np.inf)
    fill_jacobian(block)
    jacobian = block[JACOBIAN:].reshape(11, BLOCK)
    outside = block[DISTANCE : DISTANCE + BLOCK] > 0
    # All axes grown by a factor: a sphere's surface moves by its radius; moved along the ray, by as much.
    np.testing.assert_allclose(jacobian[2:5, outside].sum(axis=0), -np.linalg.norm(points[outside], axis=1), rtol=1e-9)
    rays = points[outside] / np.linalg.norm(points[outside], axis=1)[:, None]
    np.testing.assert_allclose((jacobian[5:8, outside].T * rays).sum(axis=1), -1.0, rtol=1e-9)
