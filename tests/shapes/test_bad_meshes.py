"""Whatever mesh comes: a certified, finite layer 4, or an error that says why there is none."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from shape_fixtures import as_mesh, test_mesh

from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value
from hickory_stream.shapes.fit import FitConfig, fit_superquadrics
from hickory_stream.shapes.inflate import InflateConfig, inflated

COARSE = FitConfig(cells=24, joint_samples=800, num_rounds=1)


def mesh_of(vertices: object, faces: object) -> Mesh:
    vertices = np.asarray(vertices, dtype=np.float32).reshape(-1, 3)
    return Mesh(
        vertices=vertices,
        faces=np.asarray(faces, dtype=np.int32).reshape(-1, 3),
        colors=np.zeros((len(vertices), 3), np.uint8),
        is_seen=np.ones(len(vertices), bool),
    )


def certified(mesh: Mesh, margin: float, config: FitConfig = COARSE) -> Superquadrics:
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


@pytest.mark.timeout(120)
@settings(max_examples=12, deadline=None)
@given(st.integers(0, 100_000), st.integers(3, 20), st.integers(1, 30), st.sampled_from([0.0, 0.02, 5.0]))
def test_a_mesh_of_random_triangles_is_contained(seed: int, num_vertices: int, num_faces: int, margin: float) -> None:
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
def test_an_odd_mesh_is_contained(mesh: Mesh, margin: float) -> None:
    certified(mesh, margin)


@pytest.mark.parametrize("scale", [3e-3, 3e3])
def test_three_millimetres_and_three_kilometres_are_as_good_as_a_metre(scale: float) -> None:
    shape = test_mesh("monitor").copy()
    shape.apply_scale(scale / np.ptp(shape.vertices, axis=0).max())
    grown = certified(as_mesh(shape), 0.02 * scale, FitConfig())
    assert grown.semi_axes_m.max() < scale


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (mesh_of(np.empty((0, 3)), np.empty((0, 3))), "no triangles"),
        (mesh_of([[0, 0, 0], [1, 0, 0], [np.nan, 1, 0]], [[0, 1, 2]]), "1 of 3 vertices are not finite"),
        (mesh_of([[0, 0, 0], [1, 0, 0], [0, np.inf, 0]], [[0, 1, 2]]), "not finite"),
        (mesh_of([[1, 2, 3]] * 3, [[0, 1, 2]]), "one point"),
        (mesh_of([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 7]]), "vertices that it has not"),
    ],
    ids=["empty", "nan", "infinite", "point", "wrong-index"],
)
def test_what_is_no_mesh_is_refused_with_its_reason(mesh: Mesh, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        fit_superquadrics(mesh, FitConfig())
