from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.voxels import cells_of_keys, keys_of_cells
from hickory_stream.navigation.observed import Band, wall_hulls
from hickory_stream.navigation.walls import boxes_of, wall_boxes
from hickory_stream.records import ObservedSpace, Submap
from tests.navigation.rooms import VOXEL_M, boxes, seen_room

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
