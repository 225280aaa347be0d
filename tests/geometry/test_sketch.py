import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.rigid import apply, from_rotation_translation, rotation_from_quaternion, yaw_rotation
from hickory_stream.geometry.sketch import sketch
from hickory_stream.geometry.superquadric import implicit_value, volumes_m3, world_bounds
from tests.strategies import quadric, radial_distance_m


def sketch_of(points):
    return sketch(points, gravity_aligned_box(points, 0.01))


def seen(solid, *, share=1.0, noise_m=0.003):
    """Return points of the surface that face a camera at one side, and more of the rest as the share grows."""
    points, faces = trimesh.sample.sample_surface(solid, 3000, seed=1)
    towards = solid.face_normals[faces] @ np.array([0.8, 0.3, 0.5])
    kept = points[towards >= np.quantile(towards, 1 - share)]
    return np.asarray(kept + np.random.default_rng(0).normal(size=kept.shape) * noise_m)


def is_within(solid, points):
    """Return which points are inside of a convex solid: behind all of its faces."""
    offsets = (solid.face_normals * solid.triangles_center).sum(axis=1)
    return np.asarray((points @ solid.face_normals.T <= offsets).all(axis=1))


def placed(solid, yaw):
    solid.apply_transform(from_rotation_translation(yaw_rotation(yaw), np.array([3.0, -2.0, 0.7])))
    return solid


SOLIDS = {
    "box": lambda: trimesh.creation.box((0.5, 0.35, 0.3)),
    "cylinder": lambda: trimesh.creation.cylinder(radius=0.15, height=0.45, sections=48),
    "sphere": lambda: trimesh.creation.icosphere(subdivisions=4, radius=0.15),
    "capsule": lambda: trimesh.creation.capsule(height=0.3, radius=0.1),
}
# Of what is seen all around, and of the half that faces the camera.
LEAST_IOU = {"box": (0.85, 0.6), "cylinder": (0.85, 0.6), "sphere": (0.85, 0.45), "capsule": (0.8, 0.45)}


@pytest.mark.parametrize("name", list(SOLIDS))
@pytest.mark.parametrize(("column", "share"), [(0, 1.0), (1, 0.6)])
def test_a_sketch_overlaps_the_solid(name, column, share):
    solid = placed(SOLIDS[name](), 0.4)
    found = sketch_of(seen(solid, share=share))
    low, high = solid.bounds + np.array([[-0.05], [0.05]])
    cells = np.random.default_rng(1).uniform(low, high, (4000, 3))
    truth, claimed = is_within(solid, cells), implicit_value(found, 0, cells) <= 1
    assert (truth & claimed).sum() / (truth | claimed).sum() >= LEAST_IOU[name][column]


@pytest.mark.parametrize("name", list(SOLIDS))
def test_no_upright_primitive_costs_less_than_the_sketch(name):
    solid = placed(SOLIDS[name](), 0.4)
    points = seen(solid, share=0.7)[::12]
    box = gravity_aligned_box(points, 0.01)
    exponents = np.array([(e1, e2) for e1 in (0.1, 0.3, 0.6, 1.0) for e2 in (0.1, 0.3, 0.6, 1.0)])
    turns = [np.eye(3)[:, list(order)] for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1))]
    trials = [
        quadric(
            own, box.half_extents_m @ turn, from_rotation_translation(box.world_from_box[:3, :3] @ turn, box.center)
        )
        for own in exponents
        for turn in turns
    ]
    found = sketch_of(points)
    assert len(points) <= 250, "the sketch looks at all of them"
    assert cost(found, points) <= min(cost(trial, points) for trial in trials) * (1 + 1e-9)


def cost(primitive, points):
    """Return the mean radial distance to the points times the cube root of the volume."""
    return float(np.abs(radial_distance_m(primitive, points)).mean() * np.cbrt(volumes_m3(primitive)[0]))


def test_a_leaning_rod_is_no_upright_box():
    rod = trimesh.creation.cylinder(radius=0.03, height=1.0, sections=32)
    tilt = from_rotation_translation(rotation_from_quaternion(0.3, 0.1, 0.0, 0.95), np.array([1.0, 1.0, 0.5]))
    rod.apply_transform(tilt)
    points = seen(rod, noise_m=0.001)
    assert volumes_m3(sketch_of(points))[0] < 0.1 * gravity_aligned_box(points, 0.01).volume_m3


def test_a_sketch_moves_with_its_cloud_and_is_repeatable():
    points = seen(placed(SOLIDS["cylinder"](), 0.2))
    first, again = sketch_of(points), sketch_of(points.copy())
    assert np.array_equal(first.world_from_local, again.world_from_local)
    turn = from_rotation_translation(yaw_rotation(1.0), np.array([-4.0, 2.0, 0.0]))
    there = sketch_of(apply(turn, points))
    samples = np.random.default_rng(2).uniform(-0.3, 0.3, (500, 3)) + first.world_from_local[0, :3, 3]
    before, after = implicit_value(first, 0, samples), implicit_value(there, 0, apply(turn, samples))
    assert ((before <= 1) == (after <= 1)).mean() > 0.97


@pytest.mark.parametrize("extent", [(1.0, 0.0, 0.0), (1.0, 0.6, 0.0), (0.0, 0.0, 0.8), (0.0, 0.0, 0.0)])
def test_collinear_and_coplanar_clouds_have_a_thin_sketch(extent):
    points = np.random.default_rng(3).uniform(0, 1, (400, 3)) * extent
    bounds = world_bounds(sketch_of(points))[0]
    assert np.ptp(bounds, axis=0) == pytest.approx(np.maximum(extent, 0.02), abs=0.03)


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.ones((19, 3)), np.full((100, 3), np.nan)])
def test_too_few_points_have_none(points):
    assert sketch(points, gravity_aligned_box(np.array([[0.0, 0, 0], [2.0, 2, 2]]), 0.01)) is None


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.003, 3000.0), st.floats(0, 1))
def test_a_sketch_is_finite_and_inside_the_box_of_the_cloud(seed, size_m, flatness):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(200, 3)) * size_m * np.array([1.0, 1.0, flatness]) + rng.uniform(-50, 50, 3)
    box = gravity_aligned_box(points, 0.01)
    found = sketch(points, box)
    assert np.isfinite(found.world_from_local).all()
    reach = np.abs(found.world_from_local[0, :3, 3] - box.center) @ box.world_from_box[:3, :3]
    assert (np.abs(reach) <= 2 * box.half_extents_m.max()).all()
    assert (found.semi_axes_m >= 0.01 - 1e-9).all()
    assert found.semi_axes_m.max() <= 1.01 * np.linalg.norm(box.half_extents_m)
