import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from hickory_stream.geometry.superquadric import Superquadrics, outward_normals, radial_distance_m, volumes_m3
from hickory_stream.geometry.superquadric_surface import display_mesh, surface_points
from hickory_stream.pictures.open3d_import import import_open3d

axis = st.floats(0.005, 1.0)
exponent = st.floats(0.1, 2.0)


@st.composite
def at_the_origin(draw):
    return Superquadrics(
        exponents=np.array([[draw(exponent), draw(exponent)]]),
        semi_axes_m=np.array([[draw(axis), draw(axis), draw(axis)]]),
        world_from_local=np.eye(4)[None],
    )


def in_all_directions(primitive, count):
    """Return points of the surface by the usual parameters, which the mesh does not use."""
    rng = np.random.default_rng(0)
    e1, e2 = primitive.exponents[0]
    eta, omega = rng.uniform(-np.pi / 2, np.pi / 2, count), rng.uniform(-np.pi, np.pi, count)

    def power(value, exponent):
        return np.sign(value) * np.abs(value) ** exponent

    unit = np.stack(
        [
            power(np.cos(eta), e1) * power(np.cos(omega), e2),
            power(np.cos(eta), e1) * power(np.sin(omega), e2),
            power(np.sin(eta), e1),
        ],
        axis=1,
    )
    return np.asarray(unit * primitive.semi_axes_m[0])


@settings(max_examples=40, deadline=None)
@given(at_the_origin(), st.sampled_from([None, 0.05, 0.001]))
def test_surface_points_are_within_the_stated_error(primitive, share):
    largest = float(primitive.semi_axes_m.max())
    allowed = 0.01 * largest if share is None else share * largest
    vertices, faces = display_mesh(primitive, 0, None if share is None else allowed)
    assert np.abs(radial_distance_m(primitive, 0, vertices)).max() <= 1e-5 * largest
    o3d = import_open3d()
    scene = o3d.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(vertices, faces.astype(np.uint32))
    points = in_all_directions(primitive, 2000).astype(np.float32)
    distances = scene.compute_distance(o3d.core.Tensor(points)).numpy()
    assert distances.max() <= allowed + 1e-4 * largest


@settings(max_examples=40, deadline=None)
@given(at_the_origin())
def test_the_mesh_is_closed_and_looks_outwards(primitive):
    vertices, faces = display_mesh(primitive, 0)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert 0 < mesh.volume <= volumes_m3(primitive)[0] * (1 + 1e-4)
    middles, areas = mesh.triangles_center, mesh.area_faces
    large = areas > 1e-9 * areas.sum()
    facing = (mesh.face_normals * outward_normals(primitive, 0, middles)).sum(axis=1)
    assert (facing[large] > 0).all()


def test_flat_surface_needs_few_vertices():
    def vertices(exponents, share):
        body = Superquadrics(
            exponents=np.array([exponents]), semi_axes_m=np.ones((1, 3)), world_from_local=np.eye(4)[None]
        )
        return len(display_mesh(body, 0, share)[0])

    assert vertices((2.0, 2.0), 0.01) == 6
    assert vertices((0.1, 0.1), 0.01) < vertices((1.0, 1.0), 0.01) < vertices((1.0, 1.0), 0.001)


@settings(max_examples=40, deadline=None)
@given(at_the_origin(), st.integers(20, 400))
def test_surface_points_lie_on_the_surface_and_leave_no_gap(primitive, count):
    points = surface_points(primitive, 0, count)
    largest = float(primitive.semi_axes_m.max())
    assert points.shape == (count, 3)
    assert np.abs(radial_distance_m(primitive, 0, points)).max() <= 1e-9 * largest
    vertices, faces = display_mesh(primitive, 0, 0.001 * largest)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    everywhere, _ = trimesh.sample.sample_surface(mesh, 3000, seed=0)
    gaps, _ = cKDTree(points).query(everywhere)
    # Points of a needle stand one behind another.
    spacing = max(np.sqrt(mesh.area / count), 2 * largest / count)
    assert gaps.max() <= 3.5 * spacing


@settings(max_examples=30, deadline=None)
@given(at_the_origin(), st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.1, 1)))
def test_the_share_of_points_beyond_a_plane_is_that_of_the_area(primitive, direction):
    points = surface_points(primitive, 0, 1000)
    vertices, faces = display_mesh(primitive, 0, 0.0005 * float(primitive.semi_axes_m.max()))
    everywhere, _ = trimesh.sample.sample_surface(trimesh.Trimesh(vertices, faces, process=False), 20_000, seed=0)
    along = np.array(direction) / primitive.semi_axes_m[0]
    limit = 0.3 * float((everywhere @ along).max())
    share = float((everywhere @ along > limit).mean())
    assert float((points @ along > limit).mean()) == pytest.approx(share, abs=0.05)


def test_the_same_primitive_gives_the_same_points():
    body = Superquadrics(
        exponents=np.array([[0.3, 1.0]]), semi_axes_m=np.array([[0.3, 0.2, 0.1]]), world_from_local=np.eye(4)[None]
    )
    assert np.array_equal(surface_points(body, 0, 77), surface_points(body, 0, 77))
