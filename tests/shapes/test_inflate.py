"""Layer 4: it contains the object, never shrinks, and does not explode on thin plates."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from shape_fixtures import as_mesh, test_mesh

from hickory_stream.geometry.superquadric import Superquadrics, implicit_value, volumes_m3
from hickory_stream.ports import Reconstruction
from hickory_stream.shapes.fit import FitConfig, fit_superquadrics
from hickory_stream.shapes.inflate import InflateConfig, closest_primitive, inflate, inflate_to_cover, moved_outwards

PLATE = Superquadrics(
    exponents=np.full((1, 2), 0.1), semi_axes_m=np.array([[0.6, 0.4, 0.02]]), world_from_local=np.eye(4)[None]
)


@st.composite
def primitives(draw: st.DrawFn) -> Superquadrics:
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


@given(
    primitives(), st.integers(0, 10_000), st.sampled_from([0.5, 1.0]), st.sampled_from(["per_axis", "single_factor"])
)
def test_inflation_covers_every_point_and_never_shrinks(before, seed, g, rule) -> None:
    points = np.random.default_rng(seed).normal(size=(60, 3))
    after = inflate_to_cover(before, points, InflateConfig(rule=rule, g=g))
    owner = closest_primitive(before, points)
    for i in range(len(before)):
        assert (implicit_value(after, i, points[owner == i]) <= g * (1 + 1e-6)).all()
    assert (after.semi_axes_m >= before.semi_axes_m * (1 - 1e-12)).all()


@given(primitives(), st.integers(0, 10_000))
def test_growing_each_axis_takes_no_more_volume_than_one_factor(before, seed) -> None:
    points = np.random.default_rng(seed).normal(size=(60, 3))
    per_axis, single = (inflate_to_cover(before, points, InflateConfig(rule=r)) for r in ("per_axis", "single_factor"))
    assert (volumes_m3(per_axis) <= volumes_m3(single) * 1.01).all()


def test_the_single_factor_is_the_papers_gamma() -> None:
    sphere = Superquadrics(exponents=np.ones((1, 2)), semi_axes_m=np.ones((1, 3)), world_from_local=np.eye(4)[None])
    after = inflate_to_cover(sphere, np.array([[0.0, 0.0, 3.0]]), InflateConfig(rule="single_factor", g=0.25))
    # G = 9 there: gamma = (9 / 0.25)^(1/2) = 6.
    assert after.semi_axes_m[0] == pytest.approx([6.0, 6.0, 6.0])


def test_a_margin_of_five_centimetres_thickens_a_plate_by_about_that_and_not_by_its_ratio() -> None:
    corners = np.array([[x, y, z] for x in (-0.65, 0.65) for y in (-0.45, 0.45) for z in (-0.07, 0.07)])
    per_axis = inflate_to_cover(PLATE, corners, InflateConfig())
    single = inflate_to_cover(PLATE, corners, InflateConfig(rule="single_factor"))
    assert (per_axis.semi_axes_m[0] < np.array([0.75, 0.55, 0.12])).all()
    assert single.semi_axes_m[0, 0] > 2.0


@pytest.mark.parametrize("name", ["chair", "mug", "table", "torus", "organic"])
@pytest.mark.parametrize("r_safe_m", [0.0, 0.02, 0.05])
def test_the_surface_and_the_points_of_layer_1_are_inside(name: str, r_safe_m: float) -> None:
    mesh = as_mesh(test_mesh(name))
    fitted = fit_superquadrics(mesh, FitConfig())
    layer_1 = mesh.vertices[::7] + np.float32(0.004)
    after, containment = inflate(
        fitted, Reconstruction(mesh=mesh, world_from_object=np.eye(4)), layer_1, InflateConfig(r_safe_m=r_safe_m)
    )
    assert containment.num_outside <= 0.001 * containment.num_checked
    assert len(after) == len(fitted)


def test_points_move_outwards_by_the_margin_and_the_centre_stays() -> None:
    moved = moved_outwards(np.array([[2.0, 0, 0], [0.0, 0, 0]]), np.zeros(3), 0.5)
    assert moved.tolist() == [[2.5, 0, 0], [0, 0, 0]]
