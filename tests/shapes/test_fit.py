import numpy as np
import pytest
import trimesh
from hickory_stream.geometry.rigid import apply, yaw_rotation
from hickory_stream.geometry.superquadric import log_implicit_value, volumes_m3, world_bounds
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fit_superquadrics, fitted_shape
from hickory_stream.shapes.fit.quadric_lm import refined, row_of
from hickory_stream.shapes.fit.tangent_planes import distances_of
from hickory_stream.shapes.sdf import distance_grid
from tests.shapes.shape_fixtures import as_mesh, test_mesh
from tools.evaluation.shapes.meshes import hollow_mesh

CONFIG = FitConfig()


def union_iou(primitives, mesh):
    grid = distance_grid(np.asarray(mesh.vertices), mesh.faces.astype(np.int32), cells=48, band_cells=3.0)
    points = grid.points(np.arange(grid.values.size))
    inside = np.zeros(len(points), dtype=bool)
    for i in range(len(primitives)):
        inside |= log_implicit_value(primitives, i, points) < 0
    truth = grid.values.ravel() < 0
    return float((inside & truth).sum() / (inside | truth).sum())


@pytest.mark.parametrize(("name", "most", "iou"), [
    ("box", 1, 0.97), ("cylinder", 1, 0.97), ("sphere", 1, 0.97), ("ellipsoid", 1, 0.97), ("capsule", 2, 0.95),
    ("bottle", 4, 0.92), ("mug", 6, 0.95), ("chair", 7, 0.85), ("table", 6, 0.9), ("shelf", 3, 0.95),
    ("monitor", 4, 0.9), ("torus", 9, 0.88), ("organic", 4, 0.93),
])  # fmt: skip
def test_few_primitives_explain_the_object(name, most, iou):
    fitted = fit_superquadrics(as_mesh(test_mesh(name)), CONFIG)
    assert len(fitted) <= most
    assert union_iou(fitted, test_mesh(name)) >= iou
    assert (np.diff(volumes_m3(fitted)) <= 1e-5 * volumes_m3(fitted)[0]).all()
    assert (fitted.exponents >= 0.1).all()
    assert (fitted.exponents <= 2.0).all()


def test_a_turned_box_is_found_with_its_size_and_place():
    mesh = trimesh.creation.box((0.6, 0.3, 0.2))
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = yaw_rotation(0.4), (1.0, 2.0, 3.0)
    mesh.apply_transform(pose)
    fitted = fit_superquadrics(as_mesh(mesh), CONFIG)
    assert len(fitted) == 1
    assert np.sort(fitted.semi_axes_m[0]) == pytest.approx([0.1, 0.15, 0.3], rel=0.05)
    assert fitted.world_from_local[0, :3, 3] == pytest.approx([1.0, 2.0, 3.0], abs=0.01)


@pytest.mark.parametrize("scale", [0.003, 3000.0])
def test_the_unit_of_length_does_not_matter(scale):
    small = fit_superquadrics(as_mesh(test_mesh("monitor")), CONFIG)
    scaled = test_mesh("monitor").copy()
    scaled.apply_scale(scale)
    large = fit_superquadrics(as_mesh(scaled), CONFIG)
    assert len(large) == len(small)
    assert volumes_m3(large).sum() / scale**3 == pytest.approx(volumes_m3(small).sum(), rel=0.02)


def test_a_bowl_becomes_its_envelope():
    bowl = hollow_mesh("bowl")
    found = fitted_shape(as_mesh(bowl), FitConfig())
    assert found.kind == "envelope"
    assert len(found.primitives) <= 3
    bounds = world_bounds(found.primitives)
    assert np.abs(np.stack([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)]) - bowl.bounds).max() < 0.01
    # Half a ball of 12 cm.
    points = np.random.default_rng(0).uniform(*bowl.bounds, (4000, 3))
    is_in_ball = np.linalg.norm(points - [0, 0, 0.12], axis=1) < 0.12
    is_found = (np.array([log_implicit_value(found.primitives, i, points) for i in range(len(bounds))]) <= 0).any(
        axis=0
    )
    assert (is_found == is_in_ball).mean() > 0.93


def test_a_bin_becomes_one_upright_cylinder_around_it():
    walls = trimesh.creation.annulus(r_min=0.145, r_max=0.15, height=0.4, sections=48)
    bottom = trimesh.creation.cylinder(radius=0.15, height=0.006, sections=48)
    bottom.apply_translation([0, 0, -0.197])
    found = fit_superquadrics(as_mesh(trimesh.util.concatenate([walls, bottom])), CONFIG)
    assert found.exponents == pytest.approx(np.array([[0.1, 1.0]]))
    assert np.abs(found.world_from_local[0, 2, :3]) == pytest.approx([0, 0, 1], abs=2e-3)
    assert found.semi_axes_m[0] == pytest.approx([0.15, 0.15, 0.2], abs=0.007)


def test_a_flat_mesh_becomes_one_box_of_its_extent():
    square = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]], process=False)
    fitted = fit_superquadrics(as_mesh(square), CONFIG)
    assert len(fitted) == 1
    assert fitted.semi_axes_m[0, :2] == pytest.approx([1.0, 0.5])
    assert fitted.world_from_local[0, :3, 3] == pytest.approx([0.5, 1.0, 0.0])


def test_distances_to_a_sphere_are_exact():
    row = row_of((1.0, 1.0), np.full(3, 5.0), np.array([1.0, 2.0, 3.0]), np.eye(3))
    points = np.random.default_rng(0).uniform(-8, 8, (200, 3))
    truth = np.linalg.norm(points - row[5:8], axis=1) - 5.0
    found = distances_of(row, points, np.inf)
    outside = truth > 0
    assert found[outside] == pytest.approx(truth[outside], abs=1e-6)
    assert (np.abs(found[~outside] - truth[~outside]) < 1e-6).mean() > 0.9


def test_distances_inside_a_sharp_plate_are_those_to_its_faces():
    row = row_of((0.1, 0.1), np.array([30.0, 20.0, 2.0]), np.zeros(3), np.eye(3))
    points = np.random.default_rng(0).uniform([-27, -17, -1.5], [27, 17, 1.5], (200, 3))
    assert distances_of(row, points, np.inf) == pytest.approx(np.abs(points[:, 2]) - 2.0, abs=0.1)


def test_a_fit_from_nearby_finds_the_true_primitive():
    truth = row_of((0.5, 1.0), np.array([6.0, 4.0, 9.0]), np.array([15.0, 15, 15]), np.eye(3))
    points = np.stack(np.meshgrid(*[np.arange(30.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    distances = distances_of(truth, points, np.inf)
    near = np.abs(distances) < 3
    pose = np.eye(4)
    pose[:3, :3] = yaw_rotation(0.2)
    start = row_of((0.9, 0.7), np.array([5.0, 5.0, 7.0]), np.array([15.5, 14.5, 16]), apply(pose, np.eye(3)).T)
    found = refined(
        start, points[near], distances[near], np.ones(near.sum()), band=3.0, iterations=60, max_log_axis=4.0
    )
    assert np.exp(found[2:5]) == pytest.approx([6.0, 4.0, 9.0], abs=0.15)
    assert found[5:8] == pytest.approx([15, 15, 15], abs=0.1)
    assert found[:2] == pytest.approx([0.5, 1.0], abs=0.1)
