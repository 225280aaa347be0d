import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.rigid import yaw_rotation
from hickory_stream.shapes.inflate.residual_boxes import boxes_around


def volume(boxes, margin=0.0):
    return sum(float((2 * (box.half_extents + margin)).prod()) for box in boxes)


def tiny_triangles(rng, middles, size=0.01):
    return np.asarray(middles[:, None] + rng.uniform(-size, size, (len(middles), 3, 3)))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60), st.integers(1, 9), st.sampled_from([0.0, 0.1]))
def test_every_triangle_lies_in_the_one_box_that_holds_it(seed, count, most, margin):
    rng = np.random.default_rng(seed)
    triangles = tiny_triangles(rng, rng.normal(size=(count, 3)) * 10 ** rng.uniform(-2, 1, 3), 0.2)
    boxes = boxes_around(triangles, np.eye(3), margin=margin, most=most)
    assert 1 <= len(boxes) <= min(most, count)
    assert sorted(np.concatenate([box.held for box in boxes])) == list(range(count))
    for box in boxes:
        assert np.linalg.det(box.axes) == pytest.approx(1.0)
        local = (triangles[box.held].reshape(-1, 3) - box.center) @ box.axes
        assert (np.abs(local) <= box.half_extents + 1e-9).all()
    single = boxes_around(triangles, np.eye(3), margin=margin, most=1)
    assert volume(boxes, margin) <= volume(single, margin) * (1 + 1e-9)


def test_leaves_that_are_far_apart_get_a_box_each():
    rng = np.random.default_rng(0)
    middles = np.array([[3.0, 0, 0], [-3.0, 0, 0], [0, 3.0, 0], [0, 0, 3.0]])
    triangles = tiny_triangles(rng, np.repeat(middles, 30, axis=0) + rng.uniform(-0.1, 0.1, (120, 3)))
    boxes = boxes_around(triangles, np.eye(3), margin=0.05, most=4)
    held = sorted((sorted(box.held.tolist()) for box in boxes), key=min)
    assert held == [list(range(30 * i, 30 * i + 30)) for i in range(4)]
    assert all((box.half_extents < 0.2).all() for box in boxes)


def test_the_first_cut_is_the_best_of_all_planes_across_the_axes():
    rng = np.random.default_rng(1)
    # Longest along x, then y, then z, and nearly so in itself: principal axes are the given ones.
    triangles = tiny_triangles(rng, rng.uniform(-1, 1, (40, 3)) * [4.0, 2.0, 1.0])
    single = boxes_around(triangles, np.eye(3), margin=0.0, most=1)
    two = boxes_around(triangles, np.eye(3), margin=0.0, most=2)
    totals = []
    for axis in range(3):
        order = np.argsort((triangles.min(axis=1) + triangles.max(axis=1))[:, axis])
        for at in range(1, 40):
            sides = (triangles[order[:at]].reshape(-1, 3), triangles[order[at:]].reshape(-1, 3))
            totals.append(sum(float(np.ptp(side, axis=0).prod()) for side in sides))
    assert volume(two) <= min(totals) * (1 + 1e-9)
    assert volume(two) < 0.97 * volume(single)


def test_a_slanted_twig_gets_a_box_along_itself():
    rng = np.random.default_rng(2)
    along = yaw_rotation(0.7) @ np.array([1.0, 0, 0])
    triangles = tiny_triangles(rng, np.linspace(-1, 1, 50)[:, None] * along)
    box = boxes_around(triangles, np.eye(3), margin=0.01, most=1)[0]
    assert sorted(box.half_extents)[:2] == pytest.approx([0.01, 0.01], abs=0.005)
    assert max(box.half_extents) == pytest.approx(1.0, abs=0.02)


def test_what_would_not_get_smaller_stays_one_box():
    grid = np.stack(np.meshgrid(*[np.linspace(0, 1, 8)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    triangles = np.repeat(grid[:, None], 3, axis=1)
    assert len(boxes_around(triangles, np.eye(3), margin=0.2, most=8)) == 1
