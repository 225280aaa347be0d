from dataclasses import replace
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.superquadric import implicit_value
from hickory_stream.ports import Reconstruction, ShapeInputs
from hickory_stream.shapes.build import ShapeConfig, build_shape
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fit_superquadrics
from hickory_stream.shapes.inflate.inflation import InflateConfig, inflated
from hickory_stream.shapes.mesh_validation import usable
from tests.shapes.shape_fixtures import as_mesh, test_mesh

COARSE = FitConfig(cells=24, joint_samples=800)


def mesh_of(vertices, faces):
    vertices = np.asarray(vertices, dtype=np.float32).reshape(-1, 3)
    return Mesh(
        vertices=vertices, faces=np.asarray(faces, dtype=np.int32).reshape(-1, 3),
        colors=np.zeros((len(vertices), 3), np.uint8), is_seen=np.ones(len(vertices), bool),
    )  # fmt: skip


def certified(mesh, margin, config=COARSE):
    mesh = usable(mesh)
    fitted = fit_superquadrics(mesh, config)
    vertices = mesh.vertices.astype(np.float64)
    found = inflated(fitted, vertices, mesh.faces, np.empty((0, 3)), InflateConfig(r_safe_m=margin))
    assert found.certificate.holds
    for values in (found.primitives.exponents, found.primitives.semi_axes_m, found.primitives.world_from_local):
        assert np.isfinite(values).all()
    # Corners, middles of faces, and these moved by the margin.
    points = np.concatenate([vertices[mesh.faces.ravel()], vertices[mesh.faces].mean(axis=1)])
    directions = np.random.default_rng(0).normal(size=points.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = np.concatenate([points, points + margin * directions])
    lowest = np.min([implicit_value(found.primitives, i, points) for i in range(len(found.primitives))], axis=0)
    assert (lowest <= 1.0).all()
    return found.primitives


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 100_000), st.integers(3, 20), st.integers(1, 30), st.sampled_from([0.0, 0.02, 2.0]))
def test_a_mesh_of_random_triangles_is_contained(seed, num_vertices, num_faces, margin):
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(num_vertices, 3)) * 10 ** rng.uniform(-2, 1, 3)
    faces = rng.integers(0, num_vertices, (num_faces, 3))
    faces[0] = [0, 1, 2]
    certified(mesh_of(vertices, faces), margin)


BOX = trimesh.creation.box((0.4, 0.3, 0.2))


@pytest.mark.parametrize(
    "mesh",
    [
        as_mesh(trimesh.Trimesh(BOX.vertices, BOX.faces[:-3], process=False)),
        as_mesh(trimesh.Trimesh(BOX.vertices, BOX.faces[:, ::-1], process=False)),
        as_mesh(trimesh.Trimesh(BOX.vertices, np.concatenate([BOX.faces, BOX.faces[:4]]), process=False)),
        as_mesh(trimesh.util.concatenate([BOX, BOX.copy().apply_translation([0.1, 0.1, 0.05])])),
        as_mesh(trimesh.util.concatenate([BOX, BOX.copy().apply_translation([2.0, 0, 0])])),
        mesh_of([[0, 0, 0], [1, 0, 0], [1, 2, 0], [0, 2, 0]], [[0, 1, 2], [0, 2, 3]]),
        mesh_of([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]], [[0, 1, 2]]),
        mesh_of([[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 1, 2]]),
    ],
    ids=["open", "inside-out", "non-manifold", "self-intersecting", "two-parts", "flat", "one-triangle", "collinear"],
)
@pytest.mark.parametrize("margin", [0.0, 0.05, 2.0])
def test_an_odd_mesh_is_contained(mesh, margin):
    certified(mesh, margin)


WITH_WASTE = {
    "a vertex that no triangle uses": ([[100, 0, 0]], []),
    "one that is not finite": ([[np.nan, 0, np.inf]], []),
    "a triangle of one vertex": ([[100, 0, 0]], [[8, 8, 8]]),
    "a triangle of three vertices at one place": ([[100, 0, 0]] * 3, [[8, 9, 10]]),
}


@pytest.mark.parametrize(("vertices", "faces"), WITH_WASTE.values(), ids=WITH_WASTE.keys())
def test_what_is_no_surface_changes_nothing(vertices, faces):
    wasteful = mesh_of(np.concatenate([BOX.vertices, vertices]), [*BOX.faces.tolist(), *faces])
    clean = as_mesh(BOX)
    for margin in (0.02, 1.0):
        found, expected = certified(wasteful, margin), certified(clean, margin)
        assert np.array_equal(found.semi_axes_m, expected.semi_axes_m)
        assert np.array_equal(found.world_from_local, expected.world_from_local)


def test_a_degenerate_triangle_is_contained_along_its_line():
    certified(mesh_of(np.concatenate([BOX.vertices, [[3.0, 0, 0]]]), [*BOX.faces.tolist(), [0, 0, 8]]), 0.02)


def test_a_box_whose_sides_share_no_vertices_is_the_same_box():
    apart = mesh_of(BOX.vertices[BOX.faces.ravel()], np.arange(3 * len(BOX.faces)))
    one, other = (certified(mesh, 0.02) for mesh in (as_mesh(BOX), apart))
    assert len(other) == 1
    assert other.semi_axes_m == pytest.approx(one.semi_axes_m, rel=1e-6)


def test_a_wasteful_reconstructors_shape_keeps_its_surface():
    class Wasteful:
        name = "wasteful"

        def reconstruct(self, inputs):
            mesh = mesh_of(np.concatenate([BOX.vertices, [[100, 0, 0]]]), BOX.faces)
            return Reconstruction(mesh=replace(mesh, is_seen=np.arange(9) < 8), world_from_object=np.eye(4))

    inputs = ShapeInputs(
        points_world=np.asarray(BOX.vertices, np.float32), colors=np.zeros((8, 3), np.uint8),
        box=OrientedBox(world_from_box=np.eye(4), half_extents_m=np.array([0.2, 0.15, 0.1])), support_z_m=None,
        crops=(),
    )  # fmt: skip
    built = build_shape(inputs, Wasteful(), ShapeConfig(fit=COARSE))
    assert len(built.reconstruction.mesh.vertices) == 8
    assert (built.seen_share == 1.0).all()
    assert built.inflated.semi_axes_m.max() < 0.3


def test_points_that_are_not_finite_are_reported_and_outside():
    points = np.array([[0.0, 0, 0], [np.nan, 0, 0]])
    with pytest.raises(ValueError, match="8 vertices of faces and 2 points, 1 of them not finite"):
        inflated(fit_superquadrics(as_mesh(BOX), COARSE), BOX.vertices, BOX.faces, points, InflateConfig())


@pytest.mark.parametrize("scale", [3e-3, 3e3])
def test_three_millimetres_and_three_kilometres_work_as_a_metre(scale):
    shape = test_mesh("monitor").copy()
    shape.apply_scale(scale / np.ptp(shape.vertices, axis=0).max())
    assert certified(as_mesh(shape), min(0.02 * scale, 2.0), FitConfig()).semi_axes_m.max() < scale


@pytest.mark.parametrize(("mesh", "reason"), [
    (mesh_of(np.empty((0, 3)), np.empty((0, 3))), "no triangles"),
    (mesh_of([[0, 0, 0], [1, 0, 0], [np.nan, 1, 0]], [[0, 1, 2]]), "1 of 3 vertices are not finite"),
    (mesh_of([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]]), "not finite"),
    (mesh_of([[1, 2, 3]] * 3, [[0, 1, 2]]), "one point"),
    (mesh_of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 7]]), "vertex indices out of range"),
], ids=["empty", "nan", "infinite", "point", "wrong-index"])  # fmt: skip
def test_what_is_no_mesh_is_refused_with_its_reason(mesh, reason):
    with pytest.raises(ValueError, match=reason):
        fit_superquadrics(mesh, FitConfig())
