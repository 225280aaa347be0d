import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value, taken, volumes_m3
from hickory_stream.ports import Reconstruction
from hickory_stream.shapes.certify import Inside, certify, inside_of, uncovered_cells
from hickory_stream.shapes.fit.marching_primitives import FitConfig, fit_superquadrics
from hickory_stream.shapes.inflate.cover import NET, NET_FACTOR
from hickory_stream.shapes.inflate.inflation import InflateConfig, inflate, inflate_to_cover, inflated
from tests.shapes.shape_fixtures import as_mesh, test_mesh
from tests.strategies import quadric

PLATE = quadric((0.1, 0.1), (0.6, 0.4, 0.02))
NO_POINTS = np.empty((0, 3))
COARSE = FitConfig(cells=24, joint_samples=800)


@st.composite
def primitives(draw):
    count = draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    poses[:, :3, 3] = rng.uniform(-1, 1, (count, 3))
    return Superquadrics(
        exponents=rng.uniform(0.1, 2.0, (count, 2)),
        semi_axes_m=10 ** rng.uniform(-2, 0.3, (count, 3)),
        world_from_local=poses,
    )


def lowest_g(shape, points):
    return np.min([implicit_value(shape, i, points) for i in range(len(shape))], axis=0)


def on_sphere(rng, count):
    directions = rng.normal(size=(count, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def arrays_of(mesh):
    return np.asarray(mesh.vertices, dtype=np.float64), mesh.faces.astype(np.int32)


def sampled_solid(mesh, margin, rng):
    """Return points of the surface, each moved by the margin in a random direction and in that of the normal."""
    points, faces = trimesh.sample.sample_surface(mesh, 1500, seed=int(rng.integers(1 << 30)))
    return np.concatenate(
        [points, points + margin * on_sphere(rng, len(points)), points + margin * mesh.face_normals[faces]]
    )


def test_the_net_encloses_the_sphere():
    directions = np.abs(on_sphere(np.random.default_rng(0), 4000))
    # Every direction of the octant lies in the hull of the net, its factor and the centre.
    hull = trimesh.convex.convex_hull(np.concatenate([NET * NET_FACTOR, np.zeros((1, 3))]))
    planes = np.einsum("ij,ij->i", hull.face_normals, hull.triangles[:, 0])
    assert (directions @ hull.face_normals.T <= planes + 1e-9).all()


@given(
    primitives(), st.integers(0, 10_000), st.sampled_from([0.5, 1.0]), st.sampled_from(["per_axis", "single_factor"]),
    st.sampled_from([0.0, 0.01, 0.3]),
)  # fmt: skip
def test_inflation_holds_the_ball_around_every_point(before, seed, g, rule, margin):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(60, 3))
    after = inflate_to_cover(before, points, InflateConfig(rule=rule, g=g, r_safe_m=margin))
    balls = (points[:, None] + margin * on_sphere(rng, 40)[None]).reshape(-1, 3)
    # Each ball lies in one primitive as a whole, not only in their union.
    values = np.stack([implicit_value(after, i, balls) for i in range(len(after))]).reshape(len(after), 60, 40)
    assert (values.max(axis=2).min(axis=0) <= g).all()
    assert (after.semi_axes_m >= before.semi_axes_m * (1 - 1e-12)).all()


@given(primitives(), st.integers(0, 10_000))
def test_growing_each_axis_takes_no_more_volume_than_one_factor(before, seed):
    points = np.random.default_rng(seed).normal(size=(60, 3))
    margins = {"r_safe_m": 0.0}
    per_axis = inflate_to_cover(before, points, InflateConfig(**margins))
    single = inflate_to_cover(before, points, InflateConfig(rule="single_factor", **margins))
    assert (volumes_m3(per_axis) <= volumes_m3(single) * 1.01).all()


def test_the_single_factor_is_the_papers_gamma():
    sphere = quadric((1.0, 1.0), (1.0, 1.0, 1.0))
    after = inflate_to_cover(
        sphere, np.array([[0.0, 0.0, 3.0]]), InflateConfig(rule="single_factor", g=0.25, r_safe_m=0.0)
    )
    # G = 9 there: gamma = (9 / 0.25)^(1/2) = 6.
    assert after.semi_axes_m[0] == pytest.approx([6.0, 6.0, 6.0])


def test_a_margin_thickens_a_plate_by_about_its_length():
    corners = np.array([[x, y, z] for x in (-0.6, 0.6) for y in (-0.4, 0.4) for z in (-0.02, 0.02)])
    per_axis = inflate_to_cover(PLATE, corners, InflateConfig(r_safe_m=0.05))
    single = inflate_to_cover(PLATE, corners, InflateConfig(r_safe_m=0.05, rule="single_factor"))
    assert (per_axis.semi_axes_m[0] < np.array([0.72, 0.52, 0.1])).all()
    assert single.semi_axes_m[0, 0] > 2.0


@pytest.mark.parametrize(
    ("name", "r_safe_m"), [("chair", 0.0), ("mug", 0.02), ("table", 0.05), ("torus", 0.0), ("organic", 0.02)]
)
def test_the_surface_its_margin_and_layer_1_are_inside(name, r_safe_m):
    mesh = as_mesh(test_mesh(name))
    fitted = fit_superquadrics(mesh, FitConfig())
    layer_1 = mesh.vertices[::7] + np.float32(0.004)
    after, containment = inflate(
        fitted, Reconstruction(mesh=mesh, world_from_object=np.eye(4)), layer_1, InflateConfig(r_safe_m=r_safe_m)
    )
    assert (containment.is_certified, containment.is_fallback, containment.num_outside) == (True, False, 0)
    assert containment.margin_m == r_safe_m
    assert containment.max_g <= 1.0
    rng = np.random.default_rng(1)
    exact = trimesh.Trimesh(mesh.vertices.astype(np.float64), mesh.faces, process=False)
    moved_points = layer_1 + r_safe_m * on_sphere(rng, len(layer_1))
    assert (lowest_g(after, np.concatenate([sampled_solid(exact, r_safe_m, rng), moved_points])) <= 1.0).all()


def test_the_inside_of_a_closed_mesh_is_contained_everywhere():
    # Two plates for a solid cube: what is between them is inside the mesh, and nothing else says so.
    cube = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3] = [-0.45, 0.45]
    plates = Superquadrics(
        exponents=np.full((2, 2), 0.1), semi_axes_m=np.tile([0.5, 0.5, 0.05], (2, 1)), world_from_local=poses
    )
    found = inflated(plates, *arrays_of(cube), NO_POINTS, InflateConfig(r_safe_m=0.04))
    assert found.certificate.holds
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (4000, 3))
    assert (lowest_g(found.primitives, inside) <= 1.0).all()


@settings(max_examples=15, deadline=None)
@given(primitives(), st.integers(0, 10_000), st.floats(0.0, 0.2))
def test_a_certificate_is_given_exactly_where_it_holds(shape, seed, margin):
    rng = np.random.default_rng(seed)
    mesh = trimesh.creation.box(rng.uniform(0.1, 0.8, 3)).subdivide()
    mesh.apply_translation(rng.normal(size=3) * 0.2)
    vertices, faces = arrays_of(mesh)
    certificate = certify(
        shape, vertices, faces, NO_POINTS, inside_of(vertices, faces, r_safe_m=margin), r_safe_m=margin, g=1.0
    )
    outside = lowest_g(shape, sampled_solid(mesh, margin, rng)) > 1.0
    assert not (certificate.holds and outside.any())
    found = inflated(shape, vertices, faces, NO_POINTS, InflateConfig(r_safe_m=margin))
    assert found.certificate.holds
    assert (lowest_g(found.primitives, sampled_solid(mesh, margin, rng)) <= 1.0).all()


def test_the_certificate_counts_what_a_missing_primitive_opens():
    vertices, faces = arrays_of(test_mesh("monitor"))
    config = InflateConfig(r_safe_m=0.02)
    fitted = fit_superquadrics(as_mesh(test_mesh("monitor")), FitConfig())
    whole = inflated(fitted, vertices, faces, NO_POINTS, config)
    inside = inside_of(vertices, faces, r_safe_m=0.02)
    less = taken(whole.primitives, np.array([0, 1]))
    certificate = certify(less, vertices, faces, NO_POINTS, inside, r_safe_m=0.02, g=1.0)
    assert certificate.uncovered_triangles > 0
    assert not certificate.holds


@settings(max_examples=8, deadline=None)
@given(primitives(), st.integers(0, 10_000))
def test_a_cell_is_covered_where_one_primitive_holds_its_corners(shape, seed):
    rng = np.random.default_rng(seed)
    half = 10 ** rng.uniform(-2.5, -0.5)
    places = np.concatenate([rng.uniform(-1.5, 1.5, (300, 3)), shape.world_from_local[:, :3, 3]])
    rows = np.stack(np.meshgrid((-6, 0, 6), (-6, 0, 6), np.arange(-20, 21)), axis=-1).reshape(-1, 3)
    rows = rows + np.round(shape.world_from_local[0, :3, 3] / (2 * half))
    steps = np.unique(np.concatenate([np.round(places / (2 * half)), rows]), axis=0)
    centers = 2 * half * steps
    ends = np.append((np.diff(steps, axis=0) != (0, 0, 1)).any(axis=1), True)
    row_ends = np.flatnonzero(ends)[np.searchsorted(np.flatnonzero(ends), np.arange(len(steps)))]
    deep = np.full(len(centers), -1e3)
    inside = Inside(centers=centers, row_ends=row_ends, half_m=half, distances_m=deep, margin_m=0.0, shell_m=0.0)
    left = uncovered_cells(shape, inside, 1.0)[:, :3]
    is_left = (np.abs(left - centers[:, None]) < half).all(axis=2).any(axis=1)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = (centers[:, None] + half * signs).reshape(-1, 3)
    is_held = [implicit_value(shape, i, corners).reshape(-1, 8).max(axis=1) < 1 - 1e-6 for i in range(len(shape))]
    assert not (is_left & np.any(is_held, axis=0)).any()
    within = (centers[~is_left][:, None] + half * rng.uniform(-1, 1, (1, 40, 3))).reshape(-1, 3)
    assert (lowest_g(shape, within) <= 1.0).all()


@pytest.mark.parametrize(("name", "size_m"), [("sphere", 4.0), ("cylinder", 20.0), ("ellipsoid", 8.0)])
def test_a_large_round_thing_needs_no_box(name, size_m):
    shape = test_mesh(name).copy()
    shape.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.2])))
    shape.apply_scale(size_m / np.ptp(shape.vertices, axis=0).max())
    found = inflated(fit_superquadrics(as_mesh(shape), COARSE), *arrays_of(shape), NO_POINTS, InflateConfig())
    assert found.certificate.holds
    assert not found.is_fallback
    rng = np.random.default_rng(0)
    assert (lowest_g(found.primitives, sampled_solid(shape, 0.02, rng)) <= 1.0).all()
    assert volumes_m3(found.primitives).sum() < 1.5 * shape.volume


def test_without_a_primitive_a_box_takes_its_place_and_says_so():
    vertices, faces = arrays_of(test_mesh("chair"))
    none = taken(PLATE, np.array([], dtype=np.int64))
    found = inflated(none, vertices, faces, NO_POINTS, InflateConfig(r_safe_m=0.05))
    assert found.is_fallback
    assert found.certificate.holds
    assert len(found.primitives) == 1


def box_like(half, at=(0, 0, 0)):
    pose = np.eye(4)
    pose[:3, 3] = at
    return quadric((0.1, 0.1), half, pose)


def block(size, at):
    mesh = trimesh.creation.box(size)
    mesh.apply_translation(at)
    return mesh


# A seat, and four thin arms that reach far out from it.
SEAT = block((0.5, 0.5, 0.1), (0, 0, 0))
ARMS = [block((0.4, 0.02, 0.02), (x, y, 0.3)) for x in (-0.45, 0.45) for y in (-0.2, 0.2)]
ARMCHAIR = trimesh.util.concatenate([SEAT, *ARMS])
SEAT_ONLY = box_like((0.25, 0.25, 0.05))


def test_leftovers_of_the_fit_get_boxes_where_those_are_smaller():
    vertices, faces = arrays_of(ARMCHAIR)
    found = inflated(SEAT_ONLY, vertices, faces, NO_POINTS, InflateConfig(r_safe_m=0.02))
    without = inflated(SEAT_ONLY, vertices, faces, NO_POINTS, InflateConfig(r_safe_m=0.02, most_added=0))
    assert found.certificate.holds
    assert not found.is_fallback
    assert len(without.primitives) == 1
    # The seat with its margin, then a box for each arm.
    assert len(found.primitives) == 5
    assert (found.primitives.world_from_local[0] == SEAT_ONLY.world_from_local[0]).all()
    by_hand = 0.54 * 0.54 * 0.14 + 4 * 0.44 * 0.06 * 0.06
    assert volumes_m3(found.primitives).sum() < 1.3 * by_hand
    assert volumes_m3(without.primitives).sum() > 10 * by_hand
    assert (lowest_g(found.primitives, sampled_solid(ARMCHAIR, 0.02, np.random.default_rng(0))) <= 1.0).all()


def test_no_more_boxes_are_added_than_allowed():
    vertices, faces = arrays_of(ARMCHAIR)
    two = inflated(SEAT_ONLY, vertices, faces, NO_POINTS, InflateConfig(r_safe_m=0.02, most_added=2))
    single = inflated(SEAT_ONLY, vertices, faces, NO_POINTS, InflateConfig(r_safe_m=0.02, rule="single_factor"))
    assert (len(two.primitives), len(single.primitives)) == (3, 1)
    assert two.certificate.holds
    assert single.certificate.holds


def test_far_points_of_layer_1_get_boxes_of_their_own():
    vertices, faces = arrays_of(SEAT)
    far = np.array([1.0, 0.5, 0.4]) + np.random.default_rng(0).uniform(-0.05, 0.05, (50, 3))
    found = inflated(SEAT_ONLY, vertices, faces, far, InflateConfig(r_safe_m=0.02))
    assert found.certificate.holds
    assert 2 <= len(found.primitives) <= 3
    assert volumes_m3(found.primitives).sum() < 1.3 * (0.54 * 0.54 * 0.14 + 0.14**3)


@pytest.mark.parametrize("name", ["box", "mug", "chair", "table", "monitor"])
def test_an_object_that_its_fit_explains_gets_no_boxes(name):
    shape = test_mesh(name)
    fitted = fit_superquadrics(as_mesh(shape), FitConfig())
    found = inflated(fitted, *arrays_of(shape), NO_POINTS, InflateConfig(r_safe_m=0.05))
    assert len(found.primitives) == len(fitted)


def test_plates_around_a_solid_do_not_replace_one_primitive():
    # Boxes around the faces would be thin, but the inside has to be held, too.
    cube = trimesh.creation.box((1, 1, 1)).subdivide().subdivide()
    found = inflated(box_like((0.1, 0.1, 0.1)), *arrays_of(cube), NO_POINTS, InflateConfig(r_safe_m=0.02))
    assert found.certificate.holds
    assert volumes_m3(found.primitives).sum() < 1.3 * 1.04**3
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (4000, 3))
    assert (lowest_g(found.primitives, inside) <= 1.0).all()


def test_a_box_around_a_round_thing_becomes_round_about_its_axis():
    tube = trimesh.creation.cylinder(radius=0.2, height=0.6, sections=64)
    found = inflated(box_like((0.2, 0.2, 0.3)), *arrays_of(tube), NO_POINTS, InflateConfig(r_safe_m=0.02))
    assert found.certificate.holds
    assert found.primitives.exponents[0] == pytest.approx([0.1, 1.0])
    assert volumes_m3(found.primitives)[0] < 1.2 * np.pi * 0.22**2 * 0.64


def test_the_same_object_gives_the_same_boxes_to_the_byte():
    first, second = (
        inflated(SEAT_ONLY, *arrays_of(ARMCHAIR), NO_POINTS, InflateConfig(r_safe_m=0.02)).primitives for _ in range(2)
    )
    for name in ("exponents", "semi_axes_m", "world_from_local"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6), st.sampled_from([0.0, 0.02, 0.1]), st.sampled_from([0.5, 1.0]))
def test_leftovers_are_contained_and_take_no_more_space(seed, count, margin, g):
    rng = np.random.default_rng(seed)
    parts = [block(tuple(10 ** rng.uniform(-2, -0.3, 3)), tuple(rng.uniform(-1, 1, 3))) for _ in range(count)]
    mesh = trimesh.util.concatenate([SEAT, *parts])
    points = rng.normal(size=(5, 3))
    config = InflateConfig(r_safe_m=margin, g=g)
    found = inflated(SEAT_ONLY, *arrays_of(mesh), points, config)
    assert found.certificate.holds
    balls = points + margin * on_sphere(rng, 5)
    assert (lowest_g(found.primitives, np.concatenate([sampled_solid(mesh, margin, rng), balls])) <= g).all()
    without = inflated(SEAT_ONLY, *arrays_of(mesh), points, InflateConfig(r_safe_m=margin, g=g, most_added=0))
    assert without.is_fallback or volumes_m3(found.primitives).sum() <= volumes_m3(without.primitives).sum()
