from dataclasses import replace
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import distance_transform_edt
from hickory_stream.errors import InputError
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import taken
from hickory_stream.geometry.voxels import cells_of_keys, keys_of_cells
from hickory_stream.navigation import observed
from hickory_stream.navigation.observed import Band, rectangles, seen_columns, unknown_hulls, wall_hulls
from hickory_stream.navigation.occupancy import Cell, Occupancy, distance_field_m, frame_around
from hickory_stream.navigation.robot import Part
from hickory_stream.navigation.walls import boxes_of, wall_boxes
from hickory_stream.records import ObservedSpace, Submap
from tests.navigation.rooms import VOXEL_M, boxes, seen_room, snapshot, table
from tests.navigation.test_clearance import random_primitives

PART = Part(low_m=0.5, high_m=1.5, disc_m=0.1)


def grid_of(primitives):
    grid = Occupancy(frame_around(np.array([-1.0, -1.0]), np.array([5.0, 5.0]), 0.05), [PART])
    for i in range(len(primitives)):
        grid.put(i, taken(primitives, np.array([i])))
    return grid


@settings(max_examples=10)
@given(st.integers(0, 10_000))
def test_updates_one_by_one_leave_the_grid_as_if_it_were_new(seed):
    rng = np.random.default_rng(seed)
    first, second = random_primitives(rng, 10), random_primitives(rng, 10)
    grid = grid_of(first)
    for i in rng.permutation(10)[:6]:
        grid.remove(int(i))
    grid.remove(77)
    for i in range(10):
        grid.put(i, taken(second, np.array([i])))
    assert np.array_equal(grid.is_occupied(), grid_of(second).is_occupied())
    for i in range(10):
        grid.remove(i)
    assert not grid.is_occupied().any()


def test_a_grid_of_too_much_memory_is_refused_with_the_number():
    with pytest.raises(InputError, match=r"1000001 x 1000001 cells .* takes 8,583,086 MiB, allowed are 1,024"):
        frame_around(np.zeros(2), np.full(2, 1000.0005), 0.001)
    with pytest.raises(InputError, match="a cell of nan m"):
        frame_around(np.zeros(2), np.ones(2), float("nan"))


def test_what_is_not_finite_is_refused_by_name():
    grid = grid_of(table())
    bad = boxes(((1.0, np.nan, 1.0), (0.1, 0.1, 0.1)))
    with pytest.raises(ValueError, match="object 3 has a superquadric that is not finite"):
        grid.put(3, bad)
    with pytest.raises(ValueError, match="object 4 has corners that are not finite"):
        grid.put_hulls(4, np.full((1, 8, 3), np.inf))


@settings(max_examples=20)
@given(st.integers(0, 10_000))
def test_the_distance_field_never_promises_too_much(seed):
    blocked = np.random.default_rng(seed).random((30, 40)) < 0.02
    found = distance_field_m(blocked, 0.05)
    if not blocked.any():
        assert np.isinf(found).all()
        return
    between = distance_transform_edt(~blocked) * 0.05
    # From the nearest points of two squares; at most a diagonal less than between their centres.
    assert (found <= np.maximum(between - 0.05, 0) + 1e-4).all()
    assert (found >= between - 0.05 * np.sqrt(2) - 1e-4).all()
    assert (found[blocked] == 0).all()


@given(st.integers(0, 1000))
def test_rectangles_make_up_the_mask_without_overlap(seed):
    mask = np.random.default_rng(seed).random((9, 11)) < 0.6
    counts = np.zeros(mask.shape, int)
    for a, b, c, d in rectangles(mask):
        counts[a:c, b:d] += 1
    assert np.array_equal(counts, mask.astype(int))


@pytest.mark.parametrize("yaw", [0.0, 0.4])
def test_walls_are_occupied_and_unseen_cells_unknown(yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    pose = from_rotation_translation(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]), np.array([0.3, -0.2, 0.0]))
    submaps = snapshot(space=seen_room(dark_m=(4.0, 5.0)), world_from_submap=pose).submaps
    frame = frame_around(np.array([-4.0, -2.0]), np.array([8.0, 8.0]), 0.04)
    band = Band(low_m=0.05, high_m=0.6)
    seen = seen_columns(submaps, frame, band, 0.0)
    grid = Occupancy(frame, [Part(low_m=0.05, high_m=0.6)])
    grid.observe(seen.walls, unknown_hulls(seen.is_known, frame, band))
    states = grid.states()

    def at(x, y):
        place = (pose @ np.array([x, y, 0.0, 1.0]))[:2]
        ((row, column),) = frame.cells_of(place[None])
        return int(states[row, column])

    assert at(1.0, 1.0) == Cell.FREE
    assert at(3.0, 2.0) == Cell.FREE  # the door
    assert at(3.0, 0.7) == Cell.OCCUPIED
    assert at(-0.025, 2.0) == Cell.OCCUPIED
    assert at(4.5, 2.0) == Cell.UNKNOWN
    assert at(-0.5, -0.5) == Cell.UNKNOWN


def test_submaps_together_know_as_much_as_one():
    whole = seen_room(dark_m=(4.0, 5.0))
    # At random: columns that are cut across and in height, seams everywhere.
    is_first = np.random.default_rng(0).random(len(whole.free)) < 0.5
    first = replace(whole, free=whole.free[is_first], structure=whole.structure[::2])
    # The second submap's own ground is 10 cm, two voxels, above that of the first one.
    lowered = [
        keys_of_cells(cells_of_keys(keys) - [0, 0, 2]) for keys in (whole.free[~is_first], whole.structure[1::2])
    ]
    second = replace(whole, free=np.sort(lowered[0]), structure=np.sort(lowered[1]))
    raised = np.eye(4)
    raised[2, 3] = 0.1
    submaps = (
        Submap(id=0, world_from_submap=np.eye(4), observed_space=first),
        Submap(id=1, world_from_submap=raised, observed_space=second),
    )
    frame = frame_around(np.array([-1.0, -1.0]), np.array([7.0, 5.0]), 0.04)
    band = Band(low_m=0.05, high_m=0.6)
    expected = seen_columns(snapshot(space=whole).submaps, frame, band, 0.0).is_known
    assert 0.3 < expected.mean() < 0.6
    assert np.array_equal(seen_columns(submaps, frame, band, 0.0).is_known, expected)
    assert not seen_columns((), frame, band, 0.0).is_known.any()


@given(st.floats(-3.1, 3.1), st.floats(-0.05, 0.05), st.floats(-9.0, 9.0), st.floats(-9.0, 9.0))
@settings(max_examples=15)
def test_a_submap_is_searched_only_around_it(yaw, tilt, x, y):
    turn = trimesh.transformations.euler_matrix(tilt, -tilt / 2, yaw)[:3, :3]
    pose = from_rotation_translation(turn, np.array([x, y, 0.1]))
    submaps = snapshot(space=seen_room(dark_m=(4.0, 5.0)), world_from_submap=pose).submaps
    frame = frame_around(np.array([-4.0, -2.0]), np.array([8.0, 8.0]), 0.05)
    band = Band(low_m=0.05, high_m=0.6)
    found = seen_columns(submaps, frame, band, 0.0).is_known
    everywhere = (slice(0, frame.rows + 1), slice(0, frame.columns + 1))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(observed, "_corners_around", lambda *_: everywhere)
        assert np.array_equal(found, seen_columns(submaps, frame, band, 0.0).is_known)


def test_a_tilting_correction_does_not_add_walls():
    level, band = snapshot().submaps[0], Band(low_m=0.05, high_m=0.6)

    def tilted(rad):
        return replace(level, world_from_submap=trimesh.transformations.rotation_matrix(rad, (1, 0, 0)))

    few = len(wall_hulls(level, band, 0.0))
    assert len(wall_hulls(tilted(0.002), band, 0.0)) == few
    assert len(wall_hulls(tilted(0.1), band, 0.0)) > 20 * few
    space = level.observed_space
    cells = cells_of_keys(space.structure)
    inside = cells[(cells[:, 2] >= 3) & (cells[:, 2] < 10)]
    corners = tilted(0.002).world_from_submap[:3, :3] @ ((inside + 0.5) * space.voxel_m).T
    hulls = wall_hulls(tilted(0.002), band, 0.0)
    low, high = hulls.min(axis=1), hulls.max(axis=1)
    is_held = np.zeros(len(inside), bool)
    for first, last in zip(low, high, strict=True):
        is_held |= ((corners.T >= first) & (corners.T <= last)).all(axis=1)
    assert is_held.all()


BAND = Band(low_m=0.0, high_m=2.0)


def room_with(cells, *, without=None):
    """Return the room with more structure, and less."""
    space = seen_room()
    structure = np.union1d(space.structure, keys_of_cells(cells))
    structure = structure if without is None else np.setdiff1d(structure, keys_of_cells(without))
    space = replace(space, structure=structure, free=np.setdiff1d(space.free, structure))
    return Submap(id=0, world_from_submap=np.eye(4), observed_space=space)


def block(low, high):
    """Return the (N, 3) cells from a low corner to below a high one."""
    return np.argwhere(np.ones(np.subtract(high, low), bool)) + low


def cells_in(hulls):
    """Return the cells that boxes along the axes hold."""
    ends = np.round(np.stack([hulls.min(axis=1), hulls.max(axis=1)], axis=1) / VOXEL_M).astype(int)
    return {tuple(cell) for low, high in ends for cell in block(low, high).tolist()}


def num_posts(hulls):
    """Return how many boxes are no more than two voxels thick both ways, and higher than a metre."""
    sizes = np.ptp(hulls, axis=1)
    return int(((sizes[:, :2] < 2.5 * VOXEL_M).all(axis=1) & (sizes[:, 2] > 1.0)).sum())


@given(arrays(bool, st.tuples(*[st.integers(1, 6)] * 3)))
def test_the_union_of_the_boxes_is_the_mask(mask):
    covered = np.zeros_like(mask)
    for x0, y0, z0, x1, y1, z1 in boxes_of(mask):
        assert mask[x0:x1, y0:y1, z0:z1].all()
        covered[x0:x1, y0:y1, z0:z1] = True
    assert np.array_equal(covered, mask)


def test_a_solid_is_one_box_and_a_room_of_four_walls_is_four():
    assert len(boxes_of(np.ones((9, 4, 7), bool))) == 1
    room = np.ones((30, 20, 10), bool)
    room[1:-1, 1:-1] = False
    assert len(boxes_of(room)) == 4


def test_the_walls_of_a_room_are_a_handful_of_boxes():
    submap = room_with(np.empty((0, 3), int))
    hulls = wall_boxes([submap], BAND, 0.0)
    cells = cells_of_keys(submap.observed_space.structure)
    # The lowest two layers are the floor's.
    assert cells_in(hulls) == {tuple(cell) for cell in cells[cells[:, 2] >= 1].tolist()}
    assert len(hulls) == 6


def test_noise_before_a_wall_is_posts_for_planners_only():
    rng = np.random.default_rng(3)
    noise = np.column_stack([rng.permutation(np.arange(5, 115, 2))[:30], np.full(30, 2), rng.integers(3, 38, 30)])
    submap = room_with(noise)
    assert num_posts(wall_hulls(submap, BAND, 0.0)) >= 30
    hulls = wall_boxes([submap], BAND, 0.0)
    assert num_posts(hulls) == 0
    assert len(hulls) == 6


def test_a_wall_behind_a_sofa_reaches_the_floor():
    hidden, counter = block((20, -1, 0), (60, 0, 18)), block((70, 60, 0), (100, 72, 18))
    found = cells_in(wall_boxes([room_with(counter, without=hidden)], BAND, 0.0))
    assert {tuple(cell) for cell in hidden.tolist() if cell[2] >= 1} <= found
    assert {tuple(cell) for cell in counter.tolist() if cell[2] >= 1} <= found
    assert not {tuple(cell) for cell in block((70, 60, 18), (100, 72, 39)).tolist()} & found


def test_structure_within_an_object_is_no_wall():
    shelf = block((60, 70, 2), (80, 76, 34))
    body = boxes(((70 * VOXEL_M, 73 * VOXEL_M, 0.9), (0.6, 0.25, 0.95)))
    with_shelf = room_with(shelf)
    assert {tuple(cell) for cell in shelf.tolist()} <= cells_in(wall_boxes([with_shelf], BAND, 0.0))
    assert not {tuple(cell) for cell in shelf.tolist()} & cells_in(wall_boxes([with_shelf], BAND, 0.0, [body]))


def test_an_unseen_crack_is_filled_and_a_free_one_stays_open():
    crack = block((70, 65, 1), (100, 66, 18))
    submap = room_with(np.concatenate([block((70, 60, 1), (100, 65, 18)), block((70, 66, 1), (100, 71, 18))]))
    dark = replace(submap.observed_space, free=np.setdiff1d(submap.observed_space.free, keys_of_cells(crack)))
    middle = {tuple(cell) for cell in block((75, 65, 3), (95, 66, 15)).tolist()}
    assert not middle & cells_in(wall_boxes([submap], BAND, 0.0))
    assert middle <= cells_in(wall_boxes([replace(submap, observed_space=dark)], BAND, 0.0))


def test_the_walls_of_a_tilted_submap_lie_where_its_voxels_are():
    cells = block((0, 0, 4), (40, 2, 30))
    space = ObservedSpace(
        voxel_m=VOXEL_M, free=np.empty(0, np.int64), structure=np.sort(keys_of_cells(cells)), floor_z_m=None
    )
    c, s = np.cos(0.1), np.sin(0.1)
    tilt = from_rotation_translation(np.array([[1, 0, 0], [0, c, -s], [0, s, c]]), np.array([1.0, 2.0, 0.0]))
    (hull,) = wall_boxes([Submap(id=0, world_from_submap=tilt, observed_space=space)], BAND, -1.0)
    local = (hull - tilt[:3, 3]) @ tilt[:3, :3] / VOXEL_M
    assert local.min(axis=0) == pytest.approx([0, 0, 4])
    assert local.max(axis=0) == pytest.approx([40, 2, 30])


def test_the_walls_of_several_submaps_are_those_of_each():
    grid = np.stack(np.meshgrid(np.arange(40), np.arange(2), np.arange(30), indexing="ij"), axis=-1).reshape(-1, 3)
    first = Submap(
        id=0,
        world_from_submap=np.eye(4),
        observed_space=ObservedSpace(
            voxel_m=0.05, free=keys_of_cells(grid[:0]), structure=np.sort(keys_of_cells(grid)), floor_z_m=0.0
        ),
    )
    there = np.eye(4)
    there[0, 3] = 7.0
    second = replace(first, id=1, world_from_submap=there)
    apart = [wall_boxes([submap], BAND, 0.0) for submap in (first, second)]
    assert min(len(boxes) for boxes in apart) > 0
    assert np.array_equal(wall_boxes([first, second], BAND, 0.0), np.concatenate(apart))
    empty = replace(first, observed_space=replace(first.observed_space, structure=np.empty(0, np.int64)))
    assert wall_boxes([empty], BAND, 0.0).shape == wall_boxes([], BAND, 0.0).shape == (0, 8, 3)
