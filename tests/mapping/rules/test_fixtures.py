import numpy as np
import pytest
from hickory_stream.geometry.voxels import difference, keys_of_points, sorted_unique
from hickory_stream.mapping.entities.observed_space import add, empty_space
from hickory_stream.mapping.rules.fixtures import judged
from hickory_stream.records import ObjectKind
from tests.mapping.mapping_fixtures import box_surface, space, track

VOXEL_M = 0.05


def grid(x, y, z):
    steps = [np.arange(low + VOXEL_M / 2, max(high, low + VOXEL_M), VOXEL_M) for low, high in (x, y, z)]
    return np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


FLOOR = grid((0.0, 3.0), (-2.0, 2.0), (-0.05, 0.0))
CEILING = grid((0.0, 3.0), (-2.0, 2.0), (2.5, 2.55))
WALL = grid((-0.1, 0.0), (-2.0, 2.0), (0.0, 2.5))
AIR = grid((0.0, 3.0), (-2.0, 2.0), (0.0, 2.5))


def room(*things, structure=(FLOOR, CEILING, WALL), floor_m=0.0):
    """A room 3 m deep with a wall at x = 0, free where nothing is, after ten keyframes."""
    none = np.empty((0, 3), np.float32)
    places = ((none, *structure, *things), (none, *structure), (none, *things), (AIR,))
    solid, walls, taken, air = (sorted_unique(keys_of_points(np.concatenate(part), VOXEL_M)) for part in places)
    walls, free = difference(walls, taken), difference(air, solid)
    state = empty_space(VOXEL_M)
    for _ in range(10):
        state = add(state, space(free, walls, floor_m, difference(solid, walls)))
    return state


PICTURE = box_surface((0.02, 0.0, 1.5), (0.03, 0.6, 0.4))
SCREEN = box_surface((0.05, 0.0, 1.3), (0.08, 1.1, 0.6))
WALL_SHELF = box_surface((0.15, 0.0, 1.4), (0.3, 1.0, 0.04))
BEAM = box_surface((1.5, 0.0, 2.42), (0.15, 3.9, 0.15))
CONDITIONER = box_surface((0.12, 0.0, 2.0), (0.22, 0.9, 0.3))
KITCHEN = np.concatenate(
    [box_surface((0.3, 0.0, 0.45), (0.6, 3.3, 0.9)), box_surface((1.4, 1.7, 0.45), (1.8, 0.6, 0.9))]
)
SHELVES = box_surface((0.2, 0.0, 1.2), (0.35, 3.8, 2.3))
IN_NICHE = grid((0.0, 0.05), (-0.5, 0.5), (0.05, 2.0))
CHAIR = box_surface((1.5, 0.0, 0.45), (0.5, 0.5, 0.9))
WARDROBE = box_surface((0.32, 0.0, 0.95), (0.55, 1.0, 1.9))
BOX_ON_FLOOR = box_surface((0.18, 0.5, 0.15), (0.3, 0.4, 0.3))
TABLE = box_surface((1.5, 0.0, 0.72), (0.8, 1.4, 0.06))
CUP = box_surface((1.5, 0.0, 0.8), (0.08, 0.08, 0.1))
LEANING = box_surface((0.1, 0.8, 0.3), (0.12, 0.5, 0.6))

FIXTURES = {
    "picture": PICTURE, "screen on the wall": SCREEN, "wall shelf": WALL_SHELF, "beam": BEAM,
    "air conditioner": CONDITIONER, "kitchen": KITCHEN, "wall of shelves": SHELVES, "cupboard in a niche": IN_NICHE,
}  # fmt: skip
OBJECTS = {
    "chair": (CHAIR,), "wardrobe": (WARDROBE,), "box at the wall": (BOX_ON_FLOOR,), "cup on a table": (CUP, TABLE),
    "table": (TABLE, CHAIR), "board that leans on the wall": (LEANING,),
}  # fmt: skip


def probability(state, points):
    found, why = judged(track(1, points, sightings=9), state)
    assert (found.kind is ObjectKind.FIXTURE) == (found.fixture_probability > 0.5)
    assert f"a fixture by {found.fixture_probability:.2f}" in why
    return found.fixture_probability


@pytest.mark.parametrize("name", FIXTURES)
def test_what_only_the_room_holds_or_no_one_carries_is_a_fixture(name):
    structure = (FLOOR, CEILING, WALL[(np.abs(WALL[:, 1]) > 0.5) | (WALL[:, 2] > 2.0)]) if "niche" in name else None
    state = room(FIXTURES[name], **({"structure": structure} if structure else {}))
    assert probability(state, FIXTURES[name]) > 0.5


@pytest.mark.parametrize("name", OBJECTS)
def test_what_stands_on_something_and_can_be_carried_is_an_object(name):
    assert probability(room(*OBJECTS[name]), OBJECTS[name][0]) < 0.5


@pytest.mark.parametrize("points", [*FIXTURES.values(), CHAIR, CUP])
def test_without_floor_or_structure_there_is_a_probability(points):
    for state in (empty_space(VOXEL_M), room(points, structure=(), floor_m=None), room(points, floor_m=None)):
        assert 0.0 <= probability(state, points) <= 1.0


def test_a_picture_is_a_fixture_where_no_floor_is_in_view():
    assert probability(room(PICTURE, structure=(WALL,), floor_m=None), PICTURE) > 0.5


def test_a_glass_door_and_a_mirror_are_judged_by_what_was_seen():
    """Of glass depth cameras see the frame, behind a mirror a room that is not there."""
    frame = np.concatenate([box_surface((0.0, y, 1.0), (0.05, 0.06, 2.0)) for y in (-0.45, 0.45)])
    beside = WALL[np.abs(WALL[:, 1]) > 0.5]
    assert probability(room(frame, structure=(FLOOR, CEILING, beside)), frame) > 0.5
    behind = box_surface((-0.8, 0.0, 0.45), (0.5, 0.5, 0.9))
    assert 0.0 <= probability(room(behind), behind) < 0.5


def test_the_kind_follows_what_is_seen_later():
    """The front of a wardrobe in line with the wall beside it; then its sides, in a room that is free around it."""
    front, wall = WARDROBE[WARDROBE[:, 0] > 0.58], WALL + np.float32([0.6, 0.0, 0.0])
    beside = wall[np.abs(wall[:, 1]) > 0.5]
    assert probability(room(front, structure=(FLOOR, CEILING, beside)), front) > 0.5
    assert probability(room(WARDROBE), WARDROBE) < 0.5
