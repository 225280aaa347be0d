import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from hickory_stream.geometry import superquadric
from hickory_stream.geometry.rigid import apply, from_rotation_translation, rotation_from_quaternion
from hickory_stream.geometry.superquadric_surface import display_mesh, surface_points
from hickory_stream.pictures.open3d_import import import_open3d
from tests.strategies import quadric, radial_distance_m
from tools.evaluation.shape_score import shape_score

exponent = st.floats(0.1, 2.0)
semi_axis = st.floats(0.005, 3.0)


@st.composite
def quadrics(draw):
    quaternion = [draw(st.floats(-1, 1)) for _ in range(3)] + [draw(st.floats(0.1, 1))]
    pose = from_rotation_translation(
        rotation_from_quaternion(*quaternion), np.array([draw(st.floats(-50, 50)) for _ in range(3)])
    )
    return quadric((draw(exponent), draw(exponent)), (draw(semi_axis), draw(semi_axis), draw(semi_axis)), pose)


@given(quadrics())
def test_bounds_in_any_frame_hold_the_surface_and_touch_it(primitive):
    frame_from_world = from_rotation_translation(
        rotation_from_quaternion(0.3, -0.5, 0.2, 0.7), np.array([1.0, -20.0, 3.0])
    )
    for bounds, frame in (
        (superquadric.bounds_in(primitive, frame_from_world), frame_from_world),
        (superquadric.world_bounds(primitive), None),
    ):
        vertices = display_mesh(primitive, 0, 2e-4)[0].astype(np.float64)
        inside = vertices if frame is None else apply(frame, vertices)
        low, high = bounds[0]
        size = primitive.semi_axes_m.max()
        # A float32 is a few micrometres off at 50 m.
        assert (inside >= low - 1e-4).all() and (inside <= high + 1e-4).all()
        assert np.abs(inside.max(axis=0) - high).max() <= 2e-4 + 3e-4 * size
        assert np.abs(inside.min(axis=0) - low).max() <= 2e-4 + 3e-4 * size


@given(quadrics(), st.integers(0, 1000))
def test_normals_agree_with_finite_differences(primitive, seed):
    # Of a body of about a metre at the origin: differences lose the digits that a large offset takes.
    pose = primitive.world_from_local.copy()
    pose[0, :3, 3] = 0
    small = np.maximum(primitive.semi_axes_m / primitive.semi_axes_m.max(), 0.2)
    body = superquadric.Superquadrics(exponents=primitive.exponents, semi_axes_m=small, world_from_local=pose)
    rng = np.random.default_rng(seed)
    local = rng.choice([-1.0, 1.0], (20, 3)) * rng.uniform(0.1, 1.2, (20, 3)) * small
    points = local @ pose[0, :3, :3].T
    step = 1e-6
    ahead = np.stack([superquadric.log_implicit_value(body, 0, points + step * axis) for axis in np.eye(3)], axis=1)
    behind = np.stack([superquadric.log_implicit_value(body, 0, points - step * axis) for axis in np.eye(3)], axis=1)
    of_log = (ahead - behind) / (2 * step)
    normals = superquadric.outward_normals(body, 0, points)
    assert np.abs(normals - of_log / np.linalg.norm(of_log, axis=1, keepdims=True)).max() < 1e-3


@given(quadrics())
def test_normals_are_of_unit_length_everywhere(primitive):
    center = primitive.world_from_local[0, :3, 3]
    axes = primitive.world_from_local[0, :3, :3]
    points = np.concatenate([[center, center + 1e6, center + 1e-9], center + axes.T, center - 1e-3 * axes.T])
    normals = superquadric.outward_normals(primitive, 0, points)
    assert np.linalg.norm(normals[1:], axis=1) == pytest.approx(np.ones(len(points) - 1))


@pytest.mark.parametrize("exponents", [(1.0, 1.0), (0.1, 0.1), (0.1, 1.0), (2.0, 2.0), (0.5, 1.5)])
def test_volume_agrees_with_the_closed_mesh(exponents):
    primitive = quadric(exponents, (0.7, 0.4, 0.2))
    vertices, faces = display_mesh(primitive, 0, 1e-4)
    assert trimesh.Trimesh(vertices, faces).volume == pytest.approx(superquadric.volumes_m3(primitive)[0], rel=0.01)


def test_volumes_and_values_of_known_solids_are_exact():
    assert superquadric.volumes_m3(quadric((1.0, 1.0), (1.0, 2.0, 3.0)))[0] == pytest.approx(4 / 3 * np.pi * 6)
    assert superquadric.volumes_m3(quadric((2.0, 2.0), (1.0, 1.0, 1.0)))[0] == pytest.approx(4 / 3)
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0, 2.0], [3.0, 4.0, 0]])
    assert superquadric.implicit_value(quadric((1.0, 1.0), (1.0, 1.0, 1.0)), 0, points) == pytest.approx(
        [0, 0.25, 4, 25]
    )


@given(quadrics())
def test_implicit_value_is_finite_far_away_and_at_the_centre(primitive):
    center = primitive.world_from_local[0, :3, 3]
    values = superquadric.implicit_value(primitive, 0, np.stack([center, center + 1e6]))
    assert np.isfinite(values).all()
    assert values[0] < 1 < values[1]


@given(quadrics())
def test_scaling_a_point_scales_the_implicit_value_by_a_power(primitive):
    vertices, _ = display_mesh(primitive, 0)
    center = primitive.world_from_local[0, :3, 3]
    scaled = center + 1.5 * (vertices - center)
    value = superquadric.implicit_value(primitive, 0, scaled)
    e1 = primitive.exponents[0, 0]
    # The vertices are float32, a few micrometres off at 50 m: no claim for primitives as small as that.
    if primitive.semi_axes_m.min() > 0.1:
        assert np.log(value) * e1 / 2 == pytest.approx(np.full(len(value), np.log(1.5)), abs=2e-2)


@given(quadrics(), st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)))
def test_support_bounds_every_surface_point(primitive, direction):
    vertices, _ = display_mesh(primitive, 0)
    d = np.array([direction])
    assert (vertices @ d[0]).max() <= superquadric.support(primitive, 0, d)[0] + 1e-4


def test_sorting_puts_the_largest_volume_first_and_is_stable():
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 1, 2]
    three = superquadric.Superquadrics(
        exponents=np.ones((3, 2)), semi_axes_m=np.array([[1, 1, 1], [2, 2, 2], [1, 1, 1.0]]), world_from_local=poses
    )
    assert superquadric.sorted_by_volume(three).world_from_local[:, 0, 3].tolist() == [1, 0, 2]


axis = st.floats(0.005, 1.0)


@st.composite
def at_the_origin(draw):
    return quadric((draw(exponent), draw(exponent)), (draw(axis), draw(axis), draw(axis)))


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
    assert np.abs(radial_distance_m(primitive, vertices)).max() <= 1e-5 * largest
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
    assert 0 < mesh.volume <= superquadric.volumes_m3(primitive)[0] * (1 + 1e-4)
    middles, areas = mesh.triangles_center, mesh.area_faces
    large = areas > 1e-9 * areas.sum()
    facing = (mesh.face_normals * superquadric.outward_normals(primitive, 0, middles)).sum(axis=1)
    assert (facing[large] > 0).all()


def test_flat_surface_needs_few_vertices():
    def vertices(exponents, share):
        body = quadric(exponents, (1.0, 1.0, 1.0))
        return len(display_mesh(body, 0, share)[0])

    assert vertices((2.0, 2.0), 0.01) == 6
    assert vertices((0.1, 0.1), 0.01) < vertices((1.0, 1.0), 0.01) < vertices((1.0, 1.0), 0.001)


@settings(max_examples=40, deadline=None)
@given(at_the_origin(), st.integers(20, 400))
def test_surface_points_lie_on_the_surface_and_leave_no_gap(primitive, count):
    points = surface_points(primitive, 0, count)
    largest = float(primitive.semi_axes_m.max())
    assert points.shape == (count, 3)
    assert np.abs(radial_distance_m(primitive, points)).max() <= 1e-9 * largest
    vertices, faces = display_mesh(primitive, 0, 0.001 * largest)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    everywhere, _ = trimesh.sample.sample_surface(mesh, 3000, seed=0)
    gaps, _ = cKDTree(points).query(everywhere)
    # Points of a needle stand one behind another. They are spread by area, of which d^2 / 2 L^2 lies within d of the
    # tip of a pointed needle of half length L.
    spacing = max(np.sqrt(mesh.area / count), 2 * largest / count)
    assert gaps.max() <= max(3.5 * spacing, largest * np.sqrt(2 / count))


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


def random_rotation(rng):
    q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return q * np.sign(np.linalg.det(q))


@st.composite
def objects(draw):
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    count = draw(st.integers(1, 5))
    exponents = rng.uniform(0.1, 2.0, (count, 2))
    if draw(st.booleans()):
        exponents[:, 1] = exponents[:, 0]
    semi_axes = rng.uniform(0.05, 1.0, (count, 3))
    if draw(st.booleans()):
        semi_axes[:, 1] = semi_axes[:, 0]
    poses = np.stack([from_rotation_translation(random_rotation(rng), rng.normal(size=3)) for _ in range(count)])
    return superquadric.Superquadrics(exponents=exponents, semi_axes_m=semi_axes, world_from_local=poses)


def in_another_form(primitives, rng):
    """Return the same bodies, moved rigidly, shuffled, with their axes named in other ways."""
    exponents, axes = primitives.exponents.copy(), primitives.semi_axes_m.copy()
    poses = primitives.world_from_local.copy()
    for i in range(len(primitives)):
        orders = [(0, 1, 2), (1, 0, 2)]
        if exponents[i, 0] == exponents[i, 1]:
            orders += [(1, 2, 0), (2, 0, 1), (0, 2, 1), (2, 1, 0)]
        order = list(orders[rng.integers(len(orders))])
        axes[i] = axes[i, order]
        rotation = poses[i, :3, :3][:, order] * rng.choice([-1.0, 1.0], 3)
        rotation[:, 2] *= np.sign(np.linalg.det(rotation))
        poses[i, :3, :3] = rotation
    form = superquadric.Superquadrics(exponents=exponents, semi_axes_m=axes, world_from_local=poses)
    place = from_rotation_translation(random_rotation(rng), rng.normal(size=3))
    return superquadric.moved(superquadric.taken(form, rng.permutation(len(form))), place)


@given(objects(), st.integers(0, 1000))
def test_equal_shapes_score_one_in_whatever_form(shape, seed):
    assert shape_score(shape, in_another_form(shape, np.random.default_rng(seed))) == pytest.approx(1.0, abs=1e-12)


@given(objects(), objects())
def test_the_score_is_symmetric_and_within_its_bounds(a, b):
    score = shape_score(a, b)
    assert 0 <= score <= 1
    assert shape_score(b, a) == pytest.approx(score, abs=1e-12)


@given(objects(), objects(), st.floats(0.1, 3.0))
def test_a_smaller_sigma_never_raises_the_score(a, b, sigma):
    assert shape_score(a, b, sigma_geo=sigma) <= shape_score(a, b, sigma_geo=2 * sigma) + 1e-12


@given(objects(), st.integers(0, 1000))
def test_the_canonical_form_is_one_for_all_and_the_same_body(shape, seed):
    rng = np.random.default_rng(seed)
    sharp = superquadric.Superquadrics(
        exponents=np.minimum(shape.exponents, 1.0),
        semi_axes_m=shape.semi_axes_m,
        world_from_local=shape.world_from_local,
    )
    form = superquadric.canonical(sharp)
    order = rng.permutation(len(sharp))
    again = superquadric.canonical(superquadric.taken(sharp, order))
    np.testing.assert_allclose(again.semi_axes_m, form.semi_axes_m)
    np.testing.assert_allclose(again.world_from_local, form.world_from_local, atol=1e-9)
    np.testing.assert_allclose(superquadric.canonical(form).world_from_local, form.world_from_local, atol=1e-9)
    points = rng.normal(size=(40, 3))
    inside = [
        np.min([superquadric.implicit_value(s, i, points) for i in range(len(s))], axis=0) <= 1 for s in (sharp, form)
    ]
    assert np.array_equal(*inside)


def test_a_form_with_renamed_axes_has_the_same_canonical_form():
    turned = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    a = quadric((0.5, 0.5), (3.0, 2, 1))
    b = quadric((0.5, 0.5), a.semi_axes_m[0] @ turned, from_rotation_translation(turned, np.zeros(3)))
    np.testing.assert_allclose(superquadric.canonical(b).semi_axes_m, a.semi_axes_m)
    np.testing.assert_allclose(superquadric.canonical(b).world_from_local, a.world_from_local, atol=1e-12)


def test_a_column_over_a_diamond_is_written_as_its_dual():
    diamond = quadric((0.1, 1.9), (0.2, 0.2, 0.5))
    square = superquadric.canonical(diamond)
    assert square.exponents[0, 1] == pytest.approx(0.1)
    assert square.semi_axes_m[0].min() == pytest.approx(0.2 / np.sqrt(2), rel=0.05)
    assert superquadric.volumes_m3(square)[0] == pytest.approx(superquadric.volumes_m3(diamond)[0], rel=0.03)
    assert shape_score(diamond, square) > 0.97


def test_the_score_of_a_sphere_is_worked_out_by_hand():
    a, b = quadric((1.0, 1.0), (1.0, 1.0, 1.0)), quadric((0.5, 0.8), (2.0, 1.0, 0.5))
    expected = np.exp(-0.7) * (0.5 + 1 + 0.5) / 3
    # For a sphere no other order of the axes is better than the one that the paper writes.
    assert shape_score(a, b) == pytest.approx(expected)


def test_volume_without_a_partner_counts_against():
    poses = np.tile(np.eye(4), (2, 1, 1))
    two = superquadric.Superquadrics(
        exponents=np.ones((2, 2)), semi_axes_m=np.array([[1.0, 1, 1], [1, 1, 1]]), world_from_local=poses
    )
    assert shape_score(two, superquadric.taken(two, np.array([0]))) == pytest.approx(0.5)
    assert shape_score(two, superquadric.taken(two, np.array([], dtype=np.int64))) == 0.0
