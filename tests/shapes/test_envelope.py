import numpy as np
import trimesh
from hickory_stream.shapes.fit.envelope import filled
from hickory_stream.shapes.sdf import distance_grid
from tools.evaluation.shapes.meshes import hollow_mesh, test_mesh


def grid_of(mesh):
    return distance_grid(np.asarray(mesh.vertices), mesh.faces.astype(np.int32), cells=32, band_cells=3.0)


def volume_of(grid):
    return float((grid.values < 0).sum() * grid.step_m**3)


def test_a_bowl_is_filled_to_its_rim():
    found = filled(grid_of(hollow_mesh("bowl")))
    half_a_ball = 2 / 3 * np.pi * 0.12**3
    assert abs(volume_of(found) / half_a_ball - 1) < 0.12
    assert np.abs(found.values).max() <= found.band_m + 1e-9


def test_a_pipe_is_filled():
    found = filled(grid_of(trimesh.creation.annulus(r_min=0.09, r_max=0.1, height=0.4, sections=32)))
    assert abs(volume_of(found) / (np.pi * 0.1**2 * 0.4) - 1) < 0.12


def test_what_encloses_nothing_has_no_envelope():
    for name in ("box", "torus", "chair", "table", "shelf"):
        assert filled(grid_of(test_mesh(name))) is None, name
