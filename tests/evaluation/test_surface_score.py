from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.evaluation.evaluate import purity
from hickory_stream.evaluation.exposed import exposed_samples
from hickory_stream.evaluation.surface_score import (
    Filled,
    TrueSurface,
    diameter_m,
    generated_m2,
    invented_m3,
    surface_score,
)
from hickory_stream.evaluation.trajectory_error import pose_error
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import yaw_rotation
from hickory_stream.pictures.raycast import Scene, surface_of_mesh
from tests.engine.snapshot_fixtures import box_mesh

GREY = (90, 90, 90)


def moved(mesh, by):
    vertices = (mesh.vertices + np.array(by)).astype(np.float32)
    return Mesh(vertices=vertices, faces=mesh.faces, colors=mesh.colors, is_seen=mesh.is_seen)


def joined(a, b):
    return Mesh(
        vertices=np.concatenate([a.vertices, b.vertices]), faces=np.concatenate([a.faces, b.faces + len(a.vertices)]),
        colors=np.concatenate([a.colors, b.colors]), is_seen=np.concatenate([a.is_seen, b.is_seen]),
    )  # fmt: skip


def true_surface(mesh):
    samples, _ = exposed_samples(mesh, 3000, np.random.default_rng(0))
    return TrueSurface(mesh=mesh, samples=samples.astype(np.float64))


def test_a_mesh_agrees_with_itself_perfectly():
    mesh = box_mesh((0.4, 0.3, 0.2), GREY)
    score = surface_score(true_surface(mesh), mesh, np.random.default_rng(1))
    assert (score.f1_1cm, score.f1_5pct) == (1.0, 1.0)
    assert score.add_s_m == pytest.approx(0.0, abs=1e-6)


def test_a_cube_shifted_along_its_normal_loses_two_faces():
    # Shifted by 2 cm along x, the faces at +-x are 2 cm off, and the others but for a rim are still within 1 cm.
    cube = box_mesh((0.4, 0.4, 0.4), GREY)
    score = surface_score(true_surface(cube), moved(cube, (0.02, 0.0, 0.0)), np.random.default_rng(1))
    assert score.f1_1cm == pytest.approx(4 / 6, abs=0.04)
    assert score.f1_5pct == 1.0  # 5 % of 0.69 m is 3.5 cm
    # Two of six faces are 2 cm away; a fortieth of the four others lies up to 2 cm beyond the edge.
    assert score.add_s_m == pytest.approx(0.02 / 3, rel=0.1)


def test_a_mesh_twice_as_long_has_full_recall_and_half_precision():
    true, long = box_mesh((0.02, 0.02, 1.0), GREY), box_mesh((0.02, 0.02, 2.0), GREY)
    score = surface_score(true_surface(true), moved(long, (0.0, 0.0, 0.5)), np.random.default_rng(1))
    assert score.f1_1cm == pytest.approx(2 * 0.505 / 1.505, abs=0.03)
    assert score.add_s_m == pytest.approx(0.0, abs=1e-3)


@given(sides=st.tuples(*[st.floats(0.05, 2.0)] * 3))
def test_the_diameter_of_a_box_is_its_space_diagonal(sides):
    assert diameter_m(box_mesh(sides, GREY).vertices) == pytest.approx(float(np.linalg.norm(sides)), rel=1e-5)


def test_the_diameter_of_flat_and_single_points_is_found_too():
    assert diameter_m(np.array([[0, 0, 0], [3, 0, 0], [3, 4, 0], [0, 4, 0]])) == pytest.approx(5.0)
    assert diameter_m(np.zeros((3, 3))) == 0.0


def test_what_of_one_part_lies_inside_another_is_no_surface():
    inner, outer = box_mesh((0.2, 0.2, 0.2), GREY), box_mesh((0.6, 0.6, 0.6), GREY)
    samples, normals = exposed_samples(joined(inner, outer), 4000, np.random.default_rng(0))
    assert len(samples) > 3000
    assert np.abs(samples).max(axis=1) == pytest.approx(np.full(len(samples), 0.3), abs=1e-4)
    assert np.einsum("ij,ij->i", samples, normals).min() > 0


def test_an_offset_is_an_error_until_tracks_are_aligned():
    true = np.random.default_rng(3).uniform(-2, 2, (40, 3))
    error = pose_error(true @ yaw_rotation(0.3).T + np.array([0.5, -0.2, 0.0]), true)
    assert error.ate_m > 0.4
    assert error.ate_aligned_m == pytest.approx(0.0, abs=1e-9)
    assert error.num_poses == 40
    true = np.random.default_rng(4).uniform(-2, 2, (10, 3))
    assert pose_error(true + np.array([0.3, 0.0, 0.4]), true).ate_m == pytest.approx(0.5)


def test_purity_is_the_share_of_the_most_frequent_instance():
    instances = np.zeros((20, 30), dtype=np.uint16)
    instances[5:10, 10:18] = 4
    mask = np.zeros((9, 14), dtype=bool)
    mask[2:7, 3:13] = True  # in a cut-out with a margin: 5 x 10 pixels at (10, 5)
    assert purity(mask, (10, 5, 20, 10), instances) == pytest.approx(0.8)
    assert purity(mask, (10, 5, 18, 10), instances) is None  # of another size
    assert purity(np.zeros((4, 4), dtype=bool), (0, 0, 4, 4), instances) is None


@pytest.mark.parametrize("bulge_m", [0.04, 0.25])
def test_only_what_bulges_beyond_5_cm_is_invented(bulge_m):
    found = moved(box_mesh((0.8 + bulge_m, 0.6, 0.5), GREY), (bulge_m / 2, 0.0, 0.0))
    invented, volume = invented_m3(found, box_mesh((0.8, 0.6, 0.5), GREY))
    assert (invented, volume) == pytest.approx((max(bulge_m - 0.05, 0.0) * 0.6 * 0.5, 0.24), rel=0.04)


def test_a_shell_is_solid_where_floor_or_walls_close_it():
    box, floor = box_mesh((0.8, 0.6, 0.5), GREY), moved(box_mesh((4.0, 4.0, 0.02), GREY), (0.0, 0.0, -0.26))
    assert invented_m3(box, joined(box, box_mesh((0.7, 0.5, 0.4), GREY))) == pytest.approx((0.0, 0.24), rel=0.04)
    is_bottom = (box.vertices[box.faces][:, :, 2] < -0.24).all(axis=1)
    shell = replace(box, faces=box.faces[~is_bottom])
    assert invented_m3(box, shell, Scene([surface_of_mesh(floor)])) == pytest.approx((0.0, 0.24), rel=0.04)
    # In the air it holds nothing: all but 5 cm along its sides and its top is invented.
    assert invented_m3(box, shell)[0] == pytest.approx(0.7 * 0.5 * 0.45, rel=0.06)


def test_thin_plates_and_generated_surface_are_measured():
    plate = Filled(box_mesh((0.48, 0.48, 0.001), GREY))
    assert plate.volumes_m3.sum() == pytest.approx(0.48 * 0.48 * 0.0055, rel=0.15)
    # The bottom is not seen, and half a side has triangles with one or two vertices of it, three of eight all in all.
    assert generated_m2(box_mesh((0.4, 0.4, 0.4), GREY)) == pytest.approx(0.16 + 4 * 0.16 / 2 * 0.5)
