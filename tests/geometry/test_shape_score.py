import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, canonical, implicit_value, moved, taken, volumes_m3
from tools.evaluation.shape_score import shape_score


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
    return Superquadrics(exponents=exponents, semi_axes_m=semi_axes, world_from_local=poses)


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
    form = Superquadrics(exponents=exponents, semi_axes_m=axes, world_from_local=poses)
    place = from_rotation_translation(random_rotation(rng), rng.normal(size=3))
    return moved(taken(form, rng.permutation(len(form))), place)


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
    sharp = Superquadrics(
        exponents=np.minimum(shape.exponents, 1.0),
        semi_axes_m=shape.semi_axes_m,
        world_from_local=shape.world_from_local,
    )
    form = canonical(sharp)
    order = rng.permutation(len(sharp))
    again = canonical(taken(sharp, order))
    np.testing.assert_allclose(again.semi_axes_m, form.semi_axes_m)
    np.testing.assert_allclose(again.world_from_local, form.world_from_local, atol=1e-9)
    np.testing.assert_allclose(canonical(form).world_from_local, form.world_from_local, atol=1e-9)
    points = rng.normal(size=(40, 3))
    inside = [np.min([implicit_value(s, i, points) for i in range(len(s))], axis=0) <= 1 for s in (sharp, form)]
    assert np.array_equal(*inside)


def test_a_form_with_renamed_axes_has_the_same_canonical_form():
    turned = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    a = Superquadrics(
        exponents=np.full((1, 2), 0.5), semi_axes_m=np.array([[3.0, 2, 1]]), world_from_local=np.eye(4)[None]
    )
    b = Superquadrics(
        exponents=np.full((1, 2), 0.5),
        semi_axes_m=(a.semi_axes_m[0] @ turned)[None],
        world_from_local=from_rotation_translation(turned, np.zeros(3))[None],
    )
    np.testing.assert_allclose(canonical(b).semi_axes_m, a.semi_axes_m)
    np.testing.assert_allclose(canonical(b).world_from_local, a.world_from_local, atol=1e-12)


def test_a_column_over_a_diamond_is_written_as_its_dual():
    diamond = Superquadrics(
        exponents=np.array([[0.1, 1.9]]), semi_axes_m=np.array([[0.2, 0.2, 0.5]]), world_from_local=np.eye(4)[None]
    )
    square = canonical(diamond)
    assert square.exponents[0, 1] == pytest.approx(0.1)
    assert square.semi_axes_m[0].min() == pytest.approx(0.2 / np.sqrt(2), rel=0.05)
    assert volumes_m3(square)[0] == pytest.approx(volumes_m3(diamond)[0], rel=0.03)
    assert shape_score(diamond, square) > 0.97


def test_the_score_of_a_sphere_is_worked_out_by_hand():
    def one(exponents, axes):
        return Superquadrics(
            exponents=np.array([exponents]), semi_axes_m=np.array([axes]), world_from_local=np.eye(4)[None]
        )

    a, b = one((1.0, 1.0), (1.0, 1.0, 1.0)), one((0.5, 0.8), (2.0, 1.0, 0.5))
    expected = np.exp(-0.7) * (0.5 + 1 + 0.5) / 3
    # For a sphere no other order of the axes is better than the one that the paper writes.
    assert shape_score(a, b) == pytest.approx(expected)


def test_volume_without_a_partner_counts_against():
    poses = np.tile(np.eye(4), (2, 1, 1))
    two = Superquadrics(
        exponents=np.ones((2, 2)), semi_axes_m=np.array([[1.0, 1, 1], [1, 1, 1]]), world_from_local=poses
    )
    assert shape_score(two, taken(two, np.array([0]))) == pytest.approx(0.5)
    assert shape_score(two, taken(two, np.array([], dtype=np.int64))) == 0.0
