import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import apply, from_rotation_translation, rotation_from_quaternion
from hickory_stream.geometry.superquadric import (
    Superquadrics,
    bounds_in,
    implicit_value,
    log_implicit_value,
    outward_normals,
    sorted_by_volume,
    support,
    volumes_m3,
    world_bounds,
)
from hickory_stream.geometry.superquadric_surface import display_mesh

exponent = st.floats(0.1, 2.0)
semi_axis = st.floats(0.005, 3.0)


@st.composite
def quadrics(draw):
    quaternion = [draw(st.floats(-1, 1)) for _ in range(3)] + [draw(st.floats(0.1, 1))]
    pose = from_rotation_translation(
        rotation_from_quaternion(*quaternion), np.array([draw(st.floats(-50, 50)) for _ in range(3)])
    )
    return Superquadrics(
        exponents=np.array([[draw(exponent), draw(exponent)]]),
        semi_axes_m=np.array([[draw(semi_axis), draw(semi_axis), draw(semi_axis)]]),
        world_from_local=pose[None],
    )


def one(exponents, semi_axes):
    return Superquadrics(
        exponents=np.array([exponents]), semi_axes_m=np.array([semi_axes]), world_from_local=np.eye(4)[None]
    )


def signed_volume(vertices, faces):
    a, b, c = (vertices[faces[:, i]].astype(np.float64) for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@given(quadrics())
def test_bounds_in_any_frame_hold_the_surface_and_touch_it(primitive):
    frame_from_world = from_rotation_translation(
        rotation_from_quaternion(0.3, -0.5, 0.2, 0.7), np.array([1.0, -20.0, 3.0])
    )
    for bounds, frame in ((bounds_in(primitive, frame_from_world), frame_from_world), (world_bounds(primitive), None)):
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
    body = Superquadrics(exponents=primitive.exponents, semi_axes_m=small, world_from_local=pose)
    rng = np.random.default_rng(seed)
    local = rng.choice([-1.0, 1.0], (20, 3)) * rng.uniform(0.1, 1.2, (20, 3)) * small
    points = local @ pose[0, :3, :3].T
    step = 1e-6
    ahead = np.stack([log_implicit_value(body, 0, points + step * axis) for axis in np.eye(3)], axis=1)
    behind = np.stack([log_implicit_value(body, 0, points - step * axis) for axis in np.eye(3)], axis=1)
    of_log = (ahead - behind) / (2 * step)
    normals = outward_normals(body, 0, points)
    assert np.abs(normals - of_log / np.linalg.norm(of_log, axis=1, keepdims=True)).max() < 1e-3


@given(quadrics())
def test_normals_are_of_unit_length_everywhere(primitive):
    center = primitive.world_from_local[0, :3, 3]
    axes = primitive.world_from_local[0, :3, :3]
    points = np.concatenate([[center, center + 1e6, center + 1e-9], center + axes.T, center - 1e-3 * axes.T])
    normals = outward_normals(primitive, 0, points)
    assert np.linalg.norm(normals[1:], axis=1) == pytest.approx(np.ones(len(points) - 1))


@pytest.mark.parametrize("exponents", [(1.0, 1.0), (0.1, 0.1), (0.1, 1.0), (2.0, 2.0), (0.5, 1.5)])
def test_volume_agrees_with_the_closed_mesh(exponents):
    primitive = one(exponents, (0.7, 0.4, 0.2))
    vertices, faces = display_mesh(primitive, 0, 1e-4)
    assert signed_volume(vertices, faces) == pytest.approx(volumes_m3(primitive)[0], rel=0.01)


def test_volumes_and_values_of_known_solids_are_exact():
    assert volumes_m3(one((1.0, 1.0), (1.0, 2.0, 3.0)))[0] == pytest.approx(4 / 3 * np.pi * 6)
    assert volumes_m3(one((2.0, 2.0), (1.0, 1.0, 1.0)))[0] == pytest.approx(4 / 3)
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0, 2.0], [3.0, 4.0, 0]])
    assert implicit_value(one((1.0, 1.0), (1.0, 1.0, 1.0)), 0, points) == pytest.approx([0, 0.25, 4, 25])


@given(quadrics())
def test_implicit_value_is_finite_far_away_and_at_the_centre(primitive):
    center = primitive.world_from_local[0, :3, 3]
    values = implicit_value(primitive, 0, np.stack([center, center + 1e6]))
    assert np.isfinite(values).all()
    assert values[0] < 1 < values[1]


@given(quadrics())
def test_scaling_a_point_scales_the_implicit_value_by_a_power(primitive):
    vertices, _ = display_mesh(primitive, 0)
    center = primitive.world_from_local[0, :3, 3]
    scaled = center + 1.5 * (vertices - center)
    value = implicit_value(primitive, 0, scaled)
    e1 = primitive.exponents[0, 0]
    # The vertices are float32, a few micrometres off at 50 m: no claim for primitives as small as that.
    if primitive.semi_axes_m.min() > 0.1:
        assert np.log(value) * e1 / 2 == pytest.approx(np.full(len(value), np.log(1.5)), abs=2e-2)


@given(quadrics(), st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-1, 1)))
def test_support_bounds_every_surface_point(primitive, direction):
    vertices, _ = display_mesh(primitive, 0)
    d = np.array([direction])
    assert (vertices @ d[0]).max() <= support(primitive, 0, d)[0] + 1e-4


def test_sorting_puts_the_largest_volume_first_and_is_stable():
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 1, 2]
    three = Superquadrics(
        exponents=np.ones((3, 2)), semi_axes_m=np.array([[1, 1, 1], [2, 2, 2], [1, 1, 1.0]]), world_from_local=poses
    )
    assert sorted_by_volume(three).world_from_local[:, 0, 3].tolist() == [1, 0, 2]
