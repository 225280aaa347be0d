import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.navigation.clearance import ClearanceScene, rows_of
from hickory_stream.navigation.outline import TOLERANCE_M, outlines_of_hulls, outlines_of_rows, stamp
from hickory_stream.navigation.robot import Part
from tests.navigation.rooms import boxes
from tests.navigation.test_clearance import random_primitives

CELL_M = 0.033
SIZE = 160


def cells_of(corners, starts, origin=(-0.6, -0.6)):
    counts = np.zeros((SIZE, SIZE), np.int32)
    stamp(counts, corners, starts, np.array(origin), CELL_M, 1)
    return counts > 0


def body_points(rng, part, count):
    """Points (count, 3) of a body around its middle: of the hull of its corners, with disc and ball."""
    flat = rng.dirichlet(np.full(len(part.corners_m), 0.3), count) @ part.corners_m
    angle, radius = rng.uniform(0, 2 * np.pi, count), part.disc_m * np.sqrt(rng.random(count))
    flat = flat + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    heights = rng.uniform(part.low_m, part.high_m, count)
    ball = rng.normal(size=(count, 3))
    ball *= part.ball_m * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(ball, axis=1, keepdims=True)
    return np.column_stack([flat, heights]) + ball


PARTS = (
    Part(low_m=1.5, high_m=2.2, disc_m=0.1),
    Part(low_m=1.9, high_m=1.9, disc_m=0.0, ball_m=0.15, corners_m=np.array([[0.1, -0.2]])),
    Part(low_m=1.0, high_m=1.3, corners_m=np.array([[0.3, 0.1], [-0.2, 0.2], [0.0, -0.3]]), ball_m=0.02),
)


@settings(max_examples=12)
@given(st.integers(0, 10_000), st.sampled_from(PARTS))
def test_a_body_whose_cell_is_free_touches_nothing(seed, part):
    rng = np.random.default_rng(seed)
    primitives = random_primitives(rng, 12)
    occupied = cells_of(*outlines_of_rows(rows_of(primitives), part))
    scene = ClearanceScene()
    scene.put(0, primitives)
    # Beside what is occupied: where a mistake would show.
    near = np.argwhere(~occupied & (np.roll(occupied, 1, 0) | np.roll(occupied, -1, 0) | np.roll(occupied, 1, 1)))
    for _ in range(10):
        at = near[rng.integers(len(near), size=4000)] if len(near) else np.zeros((1, 2), int)
        place = np.array([-0.6, -0.6]) + (at[:, ::-1] + rng.random((len(at), 2))) * CELL_M
        points = body_points(rng, part, len(at))
        points[:, :2] += place
        assert (scene.classify(points) == 0).all()


@settings(max_examples=3)
@given(st.integers(0, 10_000))
def test_a_cell_is_occupied_within_tolerance_of_its_cylinder(seed):
    rng = np.random.default_rng(seed)
    primitives = random_primitives(rng, 8)
    part = Part(low_m=1.5, high_m=2.2, disc_m=0.1)
    occupied = np.argwhere(cells_of(*outlines_of_rows(rows_of(primitives), part)))
    occupied = rng.choice(occupied, min(len(occupied), 800), replace=False)
    scene = ClearanceScene()
    scene.put(0, primitives)
    centers = np.array([-0.6, -0.6]) + (occupied[:, ::-1] + 0.5) * CELL_M
    nearest = np.full(len(centers), np.inf)
    for height in np.linspace(1.5, 2.2, 15):
        points = np.column_stack([centers, np.full(len(centers), height)])
        nearest = np.minimum(nearest, scene.clearance_m(points, is_exact=True, reach_m=0.2))
    # Heights are 5 cm apart here: what leans over between them is at most half of that nearer.
    assert (nearest <= 0.1 + CELL_M * np.sqrt(0.5) + TOLERANCE_M + 0.025).all()


def test_a_plate_of_a_millimetre_counts_at_every_height():
    part = Part(low_m=0.05, high_m=0.2, disc_m=0.1)
    for height in (0.0495, 0.1234567, 0.2005):
        plate = boxes(((1.0, 1.0, height), (0.3, 0.2, 0.0005)))
        assert cells_of(*outlines_of_rows(rows_of(plate), part)).any()
    for height in (0.04, 0.21):
        plate = boxes(((1.0, 1.0, height), (0.3, 0.2, 0.0005)))
        assert not cells_of(*outlines_of_rows(rows_of(plate), part)).any()


def test_the_outline_of_a_box_is_the_box_grown_by_the_body():
    corners = np.array([[x, y, z] for x in (0.0, 0.4) for y in (0.0, 0.2) for z in (0.0, 1.0)])
    found, starts = outlines_of_hulls(corners[None], Part(low_m=0.2, high_m=0.3))
    assert starts.tolist() == [0, len(found)]
    assert np.unique(np.round(found, 9) + 0.0, axis=0).tolist() == [[0.0, 0.0], [0.0, 0.2], [0.4, 0.0], [0.4, 0.2]]
    body = Part(low_m=0.2, high_m=0.3, corners_m=np.array([[0.1, 0.05], [-0.1, 0.05], [-0.1, -0.05], [0.1, -0.05]]))
    found, _ = outlines_of_hulls(corners[None], body)
    assert np.unique(np.round(found, 9) + 0.0, axis=0).tolist() == [
        [-0.1, -0.05],
        [-0.1, 0.25],
        [0.5, -0.05],
        [0.5, 0.25],
    ]
    grown, _ = outlines_of_hulls(corners[None], Part(low_m=0.2, high_m=0.3, disc_m=0.1))
    # Grown by a disc: the area of the box, its border times the radius, and the disc.
    area = 0.5 * abs(np.dot(grown[:, 0], np.roll(grown[:, 1], -1)) - np.dot(grown[:, 1], np.roll(grown[:, 0], -1)))
    exact = 0.08 + 1.2 * 0.1 + np.pi * 0.01
    assert exact <= area <= exact + 1.9 * TOLERANCE_M


def test_the_slice_of_a_cone_is_that_at_the_height_of_the_band():
    # A diamond of revolution around z: at height z its radius is 0.5 (1 - |z| / 0.5).
    cone = boxes(((1.0, 1.0, 0.0), (0.5, 0.5, 0.5)))
    cone = type(cone)(exponents=[[2.0, 1.0]], semi_axes_m=cone.semi_axes_m, world_from_local=cone.world_from_local)
    found, _ = outlines_of_rows(rows_of(cone), Part(low_m=0.3, high_m=0.9), 1e-4)
    assert np.linalg.norm(found - 1.0, axis=1) == pytest.approx(0.2, abs=3e-3)


def test_whole_cells_are_stamped_and_taken_off_again():
    counts = np.zeros((6, 7), np.int32)
    corners, starts = np.array([[1.5, 1.2], [3.0, 1.2], [3.0, 2.0], [1.5, 2.0]]), np.array([0, 4])
    stamp(counts, corners, starts, np.zeros(2), 1.0, 1)
    # The square's border at x = 3 and y = 2 touches the cells beyond, too.
    expected = np.zeros((6, 7), np.int32)
    expected[1:3, 1:4] = 1
    assert np.array_equal(counts, expected)
    stamp(counts, corners, starts, np.zeros(2), 1.0, -1)
    assert not counts.any()
    # A sliver between two rows of centres, and one that leaves the grid.
    stamp(counts, np.array([[0.1, 0.9], [6.9, 0.95], [0.1, 0.91]]), np.array([0, 3]), np.zeros(2), 1.0, 1)
    assert counts[0].all()
    assert not counts[1:].any()
    stamp(counts, np.array([[-9.0, 4.5], [20.0, 4.5], [5.0, 4.6]]), np.array([0, 3]), np.zeros(2), 1.0, 1)
    assert counts[4].all()
