from dataclasses import replace
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, joined, log_implicit_value, taken
from hickory_stream.geometry.superquadric_surface import display_mesh, surface_points
from hickory_stream.geometry.voxels import keys_of_points
from hickory_stream.navigation.clearance import Answer, ClearanceScene
from hickory_stream.navigation.sweep_kernels import NEAR_M
from hickory_stream.records import ObservedSpace
from hickory_stream.shapes.build import ShapeConfig, build_shape, make_reconstructor
from tests.navigation.rooms import tracked
from tests.shapes.shape_fixtures import shape_inputs
from tests.strategies import quadric
from tools.evaluation.shapes.swept_truth import swept_distance_m


def random_primitives(rng, count, size_m=4.0):
    rotations = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    rotations[:, :, 2] *= np.sign(np.linalg.det(rotations))[:, None]
    poses = np.stack([from_rotation_translation(r, rng.uniform(0, size_m, 3)) for r in rotations])
    exponents = np.where(rng.random((count, 2)) < 0.5, rng.choice([0.1, 0.25, 1.0], (count, 2)), 0.0)
    exponents = np.where(exponents == 0, rng.uniform(0.1, 2.0, (count, 2)), exponents)
    return Superquadrics(exponents=exponents, semi_axes_m=rng.uniform(0.02, 0.5, (count, 3)), world_from_local=poses)


def brute_force(primitives, points):
    return np.any([log_implicit_value(primitives, i, points) <= 0 for i in range(len(primitives))], axis=0)


def scene_of(primitives):
    scene = ClearanceScene()
    for i in range(len(primitives)):
        scene.put(i, taken(primitives, np.array([i])))
    return scene


def one(semi_axes, at=(0, 0, 0), e=1.0):
    return quadric((e, e), semi_axes, from_rotation_translation(np.eye(3), np.array(at)))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 25))
def test_every_point_is_answered_as_by_brute_force(seed, count):
    rng = np.random.default_rng(seed)
    primitives = random_primitives(rng, count)
    points = rng.uniform(-0.5, 4.5, (3000, 3))
    near = np.concatenate([surface_points(primitives, i, 200) for i in range(count)])
    points = np.concatenate([points, near + rng.normal(size=near.shape) * 0.02])
    scene = scene_of(primitives)
    expected = brute_force(primitives, points)
    assert np.array_equal(scene.classify(points) == Answer.HIT_SEEN, expected)
    assert np.array_equal(scene.classify(points, is_parallel=True), scene.classify(points))
    assert np.array_equal(scene.is_free(points), ~expected)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_updates_one_by_one_leave_the_scene_as_if_it_were_new(seed):
    rng = np.random.default_rng(seed)
    first, second = random_primitives(rng, 12), random_primitives(rng, 12, size_m=9.0)
    scene = scene_of(first)
    for i in rng.permutation(12)[:8]:
        scene.remove(int(i))
    scene.remove(99)
    for i in range(12):
        scene.put(i, taken(second, np.array([i])))
    points = rng.uniform(-0.5, 9.5, (4000, 3))
    assert np.array_equal(scene.classify(points) == Answer.HIT_SEEN, brute_force(second, points))
    assert len(scene.rows()) == 12
    starts = points[:400]
    ends = starts + rng.normal(size=starts.shape)
    assert np.array_equal(*[one.sweep(starts, ends, radius_m=0.1) for one in (scene, scene_of(second))])


@settings(max_examples=4, deadline=None)
@given(st.integers(0, 10_000))
def test_the_bound_never_exceeds_the_exact_distance(seed):
    rng = np.random.default_rng(seed)
    primitives = random_primitives(rng, 5)
    scene = scene_of(primitives)
    points = rng.uniform(-1, 5, (60, 3))
    exact, bound = scene.clearance_m(points, is_exact=True), scene.clearance_m(points)
    assert (bound <= exact + 1e-9).all()
    meshes = [display_mesh(primitives, i, 1e-4) for i in range(5)]
    surface = np.concatenate([trimesh.remesh.subdivide_to_size(*mesh, 0.04, max_iter=30)[0] for mesh in meshes])
    sampled = cKDTree(surface).query(points)[0]
    outside = ~brute_force(primitives, points)
    assert (exact[outside] <= sampled[outside] + 1e-5).all()
    assert np.abs(exact[outside] - sampled[outside]).max(initial=0.0) < 0.03
    assert (exact[~outside] == 0).all()


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.1]), st.booleans())
def test_no_sweep_is_free_that_touches(seed, radius, is_box):
    rng = np.random.default_rng(seed)
    primitives = random_primitives(rng, 20)
    scene = scene_of(primitives)
    half = np.array([0.1, 0.05, 0.2]) if is_box else np.zeros(3)
    starts = rng.uniform(0, 4, (40, 3))
    ends = starts + rng.normal(size=starts.shape) * 0.6
    answers = scene.sweep(starts, ends, radius_m=radius, half_extents_m=half)
    # Points of the body along the way: its corners, and the ball around each.
    signs = np.array([[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)])
    ball = rng.normal(size=(12, 3))
    ball = np.concatenate([np.zeros((1, 3)), radius * ball / np.linalg.norm(ball, axis=1, keepdims=True)])
    body = (signs[:, None] * half + ball[None]).reshape(-1, 3)
    t = np.linspace(0, 1, 9)[:, None, None]
    for i in np.flatnonzero(answers == Answer.FREE):
        points = (starts[i] + t * (ends[i] - starts[i]) + body).reshape(-1, 3)
        assert not brute_force(primitives, points).any()
    # And it is no answer to call everything a hit.
    clear = scene.clearance_m(starts, is_exact=True) > radius + np.linalg.norm(half) + 1.2 * np.linalg.norm(
        ends - starts, axis=1
    )
    assert (answers[clear] == Answer.FREE).all()


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.0, 0.1]), st.booleans(), st.sampled_from([0.0, 0.6]))
def test_a_free_path_keeps_its_distance_and_a_hit_is_as_close(seed, radius, is_box, length):
    rng = np.random.default_rng(seed)
    primitives = random_primitives(rng, 8, size_m=1.5)
    half = np.array([0.1, 0.05, 0.2]) if is_box else np.zeros(3)
    starts = rng.uniform(-0.5, 2, (25, 3))
    ends = starts + rng.normal(size=starts.shape) * length
    answers = scene_of(primitives).sweep(starts, ends, radius_m=radius, half_extents_m=half)
    for start, end, answer in zip(starts, ends, answers, strict=True):
        distance = swept_distance_m(primitives, start, end, half, reach_m=radius + 0.1)
        if answer == Answer.FREE:
            assert distance > radius - 1e-6
        else:
            assert distance <= radius + NEAR_M + 1e-6


@pytest.mark.parametrize("exponent", [0.1, 1.0, 1.9985, 1.9999, 2.0])
@pytest.mark.parametrize("gap_m", [1e-3, -1e-3])
def test_a_way_along_an_edge_is_told_from_one_through_it(exponent, gap_m):
    # The corner of a diamond, of what is nearly one, of a ball and of a box, passed on the skew.
    body = one((0.5, 0.3, 0.2), e=exponent)
    corner, outwards = np.array([0.5, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    place = corner + (0.1 + gap_m) * outwards
    skew = np.array([0.0, 0.6, 0.8])
    answer = scene_of(body).sweep((place - skew)[None], (place + skew)[None], radius_m=0.1)[0]
    assert answer == (Answer.FREE if gap_m > 0 else Answer.HIT_SEEN)
    # By its distance to a corner a point is held against the same body.
    assert scene_of(body).clearance_m(place[None], is_exact=True)[0] == pytest.approx(0.1 + gap_m, abs=1e-6)


def test_a_sphere_is_as_far_as_geometry_says_and_a_graze_touches():
    scene = scene_of(one((1.0, 1.0, 1.0)))
    points = np.array([[3.0, 0, 0], [0, 0, 1.5], [1.0, 1.0, 1.0]])
    expected = [2.0, 0.5, np.sqrt(3) - 1]
    assert scene.clearance_m(points, is_exact=True) == pytest.approx(expected, abs=1e-6)
    assert scene.clearance_m(points) == pytest.approx(expected, abs=1e-6)
    starts, ends = np.array([[-3.0, 1.2, 0], [-3.0, 1.05, 0]]), np.array([[3.0, 1.2, 0], [3.0, 1.05, 0]])
    assert scene.sweep(starts, ends, radius_m=0.1).tolist() == [Answer.FREE, Answer.HIT_SEEN]


def test_generated_surface_is_a_hit_unless_the_caller_decides():
    two = Superquadrics(
        exponents=np.ones((2, 2)),
        semi_axes_m=np.ones((2, 3)),
        world_from_local=np.stack([from_rotation_translation(np.eye(3), np.array([x, 0.0, 0.0])) for x in (0, 5)]),
    )
    scene = ClearanceScene()
    scene.put(7, two, np.array([0.9, 0.1]))
    points = np.array([[0.0, 0, 0], [5.0, 0, 0], [2.5, 0, 0]])
    assert scene.classify(points).tolist() == [Answer.HIT_SEEN, Answer.HIT_GENERATED, Answer.FREE]
    assert scene.is_free(points).tolist() == [False, False, True]
    assert scene.is_free(points, may_touch_generated=True).tolist() == [False, True, True]


def test_a_box_for_leftovers_counts_as_seen():
    item = tracked(1, joined([one((0.5, 0.5, 0.5)), one((0.2, 0.2, 0.2), (2.0, 0, 0))]))
    generated = replace(item.shape, seen_share=np.array([0.1]))
    points = np.array([[0.0, 0, 0], [2.0, 0, 0]])
    scene = ClearanceScene.of([replace(item, shape=generated)])
    assert scene.classify(points).tolist() == [Answer.HIT_GENERATED, Answer.HIT_SEEN]
    around_all = replace(
        generated, inflated=one((3.0, 1, 1)), containment=replace(generated.containment, is_fallback=True)
    )
    scene = ClearanceScene.of([replace(item, shape=around_all)])
    assert scene.classify(points).tolist() == [Answer.HIT_GENERATED, Answer.HIT_GENERATED]


def test_what_was_never_seen_is_unknown_and_a_wall_is_a_hit():
    scene = scene_of(one((0.3, 0.3, 0.3)))
    free, wall = np.array([[1.0, 0, 0], [0.0, 0, 0]]), np.array([[2.0, 0, 0]])
    space = ObservedSpace(
        voxel_m=0.05, free=np.unique(keys_of_points(free, 0.05)), structure=np.unique(keys_of_points(wall, 0.05)),
        floor_z_m=None,
    )  # fmt: skip
    scene.observe(space)
    points = np.array([[1.0, 0, 0], [0.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    assert scene.classify(points).tolist() == [Answer.FREE, Answer.HIT_SEEN, Answer.HIT_SEEN, Answer.UNKNOWN]
    scene.observe(None)
    assert scene.classify(points)[3] == Answer.FREE


def test_behind_a_front_alone_is_unknown_not_occupied():
    # A cupboard with its front at y = -0.3 and a post at its back, from below its top: the box is as deep as both.
    cupboard = trimesh.creation.box((0.8, 0.6, 1.0)).apply_translation([0, 0, 0.5])
    post = trimesh.creation.box((0.1, 0.1, 1.4)).apply_translation([0.3, 0.25, 0.7])
    inputs = shape_inputs(
        trimesh.util.concatenate([cupboard, post]), 1, azimuths_rad=(-np.pi / 2, -np.pi / 2), elevation_rad=-0.15,
        noise=0.002,
    )  # fmt: skip
    config = ShapeConfig()
    built = build_shape(inputs, make_reconstructor("fused", config), config)
    scene = ClearanceScene()
    scene.put(1, built.inflated)
    front, behind = np.array([0.05, -0.3, 0.5]), np.array([0.05, 0.1, 0.5])
    before = front + np.array([[0.0, -0.5, 0.0]])
    scene.observe(
        ObservedSpace(voxel_m=0.05, free=keys_of_points(before, 0.05), structure=np.empty(0, int), floor_z_m=0)
    )
    answers = scene.classify(np.array([before[0], front, behind]))
    assert answers.tolist() == [Answer.FREE, Answer.HIT_SEEN, Answer.UNKNOWN]


def test_an_empty_scene_is_free_and_a_broken_primitive_refused():
    scene = ClearanceScene()
    points = np.zeros((3, 3))
    assert (scene.classify(points) == Answer.FREE).all()
    assert (scene.clearance_m(points, reach_m=2.0) == 2.0).all()
    assert (scene.sweep(points, points + 1, radius_m=0.1) == Answer.FREE).all()
    with pytest.raises(ValueError, match="not finite"):
        scene.put(1, one((np.nan, 1.0, 1.0)))


def test_points_that_are_not_numbers_are_never_free_of_unknown():
    scene = scene_of(one((1.0, 1.0, 1.0)))
    assert scene.classify(np.array([[np.nan, 0, 0], [np.inf, 0, 0]])).tolist() == [Answer.FREE, Answer.FREE]
