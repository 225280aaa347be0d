import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.shapes.fit.envelope import filled
from hickory_stream.shapes.sdf import distance_grid, lower_to_distances
from tools.evaluation.shapes.meshes import hollow_mesh, test_mesh


def grid_of(mesh, cells=32):
    return distance_grid(np.asarray(mesh.vertices), mesh.faces.astype(np.int32), cells=cells, band_cells=3.0)


def points_of(grid):
    return grid.points(np.arange(grid.values.size))


def box_distance(points, half):
    q = np.abs(points) - half
    return np.linalg.norm(np.maximum(q, 0), axis=1) + np.minimum(q.max(axis=1), 0)


@given(st.tuples(*[st.floats(0.02, 2.0)] * 3))
def test_distances_to_a_box_are_exact_within_the_band(size):
    grid = grid_of(trimesh.creation.box(size), cells=16)
    truth = np.clip(box_distance(points_of(grid), np.array(size) / 2), -grid.band_m, grid.band_m)
    assert np.abs(grid.values.ravel() - truth).max() < 1e-5 * max(size)


def test_turning_a_mesh_inside_out_changes_nothing():
    mesh = trimesh.creation.icosphere(subdivisions=2)
    turned = trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)
    assert np.array_equal(grid_of(mesh).values, grid_of(turned).values)


def test_a_box_without_one_face_still_has_its_inside():
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    open_box = trimesh.Trimesh(box.vertices, box.faces[box.face_normals[:, 2] < 0.5], process=False)
    grid = grid_of(open_box)
    deep = (np.abs(points_of(grid)) < 0.35).all(axis=1)
    outside = (np.abs(points_of(grid)) > 0.55).any(axis=1)
    assert (grid.values.ravel()[deep] < 0).mean() > 0.99
    assert (grid.values.ravel()[outside] > 0).mean() > 0.99


def test_overlapping_parts_are_one_solid():
    two = trimesh.util.concatenate(
        [trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1)).apply_translation([0.5, 0, 0])]
    )
    grid = grid_of(two)
    truth = (np.abs(points_of(grid) - [0.25, 0, 0]) < np.array([0.75, 0.5, 0.5])).all(axis=1)
    assert np.array_equal(grid.values.ravel() < 0, truth)


def test_a_mesh_of_one_point_is_refused():
    with pytest.raises(ValueError, match="no distance field"):
        distance_grid(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), cells=16, band_cells=3.0)


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


PIPE = trimesh.creation.annulus(r_min=0.09, r_max=0.1, height=0.4, sections=32)


@pytest.mark.parametrize(
    ("mesh", "volume_m3"), [(hollow_mesh("bowl"), 2 / 3 * np.pi * 0.12**3), (PIPE, np.pi * 0.1**2 * 0.4)]
)
def test_a_bowl_is_filled_to_its_rim_and_a_pipe(mesh, volume_m3):
    found = filled(grid_of(mesh))
    assert abs((found.values < 0).sum() * found.step_m**3 / volume_m3 - 1) < 0.12
    assert np.abs(found.values).max() <= found.band_m + 1e-9


def test_what_encloses_nothing_has_no_envelope():
    for name in ("box", "torus", "chair", "table", "shelf"):
        assert filled(grid_of(test_mesh(name))) is None, name
