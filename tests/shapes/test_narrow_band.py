import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.shapes.sdf import lower_to_distances


def squared_distance(point, triangle):
    """Return the least of the squared distances to points of a triangle, by many steps along it."""
    shares = np.linspace(0, 1, 101)
    v, w = (side.ravel() for side in np.meshgrid(shares, shares))
    v, w = v[v + w <= 1], w[v + w <= 1]
    a, b, c = triangle
    return float(np.square(a + v[:, None] * (b - a) + w[:, None] * (c - a) - point).sum(axis=1).min())


@given(st.integers(0, 1000), st.floats(0.5, 12.0))
def test_distances_are_those_to_the_nearest_triangle(seed, size):
    rng = np.random.default_rng(seed)
    corners = 4 + rng.uniform(-size / 2, size / 2, (3, 3, 3))
    squared = np.full((9, 9, 9), np.float32(9.0))
    # Nothing is buried where there is no solid.
    lower_to_distances(corners, np.zeros(squared.shape, bool), squared, 3.0)
    for cell in rng.integers(0, 9, (20, 3)):
        truth = min(squared_distance(cell, triangle) for triangle in corners)
        found = float(squared[tuple(cell)])
        # The steps along a triangle are a hundredth of its sides.
        assert found <= min(truth, 9.0) + 1e-4
        assert np.sqrt(found) >= np.sqrt(min(truth, 9.0)) - 0.02 * size


def test_surface_within_a_solid_does_not_count():
    triangle = np.array([[[4.0, 4.0, 3.0], [4.0, 4.0, 5.0], [4.0, 5.0, 4.0]]])
    squared = np.full((9, 9, 9), np.float32(9.0))
    lower_to_distances(triangle, np.ones(squared.shape, bool), squared, 3.0)
    assert (squared == 9.0).all()
