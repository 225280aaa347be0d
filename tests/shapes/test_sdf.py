import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.shapes.sdf import distance_grid


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
