from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hickory_stream.geometry.boxes import gravity_aligned_box
from hickory_stream.geometry.lazy_arrays import give_up
from hickory_stream.geometry.sketch import sketch
from hickory_stream.geometry.superquadric import implicit_value, volumes_m3
from hickory_stream.geometry.voxels import keys_of_cells, sorted_unique
from hickory_stream.navigation.costmap import Costmap, Followed
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.occupancy import Cell
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import Path, SearchConfig, blockers_at, plan
from hickory_stream.navigation.stand_ins import MARGIN_M, SEEN_SURFACE, SeenSurface, early_obstacles, stand_in_of
from hickory_stream.navigation.verify import is_verified
from hickory_stream.records import Phase, SpaceObservation
from tests.navigation.rooms import VOXEL_M, boxes, snapshot, tracked

ROBOT = load_robot("point")
CRATE_AT = np.array([4.5, 1.0])
NOTHING = np.empty(0, np.int64)


def crate(phase=Phase.TENTATIVE, *, with_shape=False):
    """A crate of 0.6 m at (4.5, 1), seen so far from its box's sides."""
    return replace(tracked(2, boxes(((*CRATE_AT, 0.3), (0.3, 0.3, 0.3))), with_shape=with_shape), phase=phase)


def surface(*, surface_cells=None, free_cells=None):
    def keys(cells):
        return NOTHING if cells is None else sorted_unique(keys_of_cells(cells))

    return SpaceObservation(
        free_keys=keys(free_cells), structure_keys=NOTHING, floor_z_m=0.0, surface_keys=keys(surface_cells)
    )


def cells_of_crate():
    x, y, z = np.meshgrid(np.arange(84, 96), np.arange(14, 26), np.arange(1, 12), indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(-1, 3)


def state_at(costmap, of, place):
    update = costmap.update(of)
    assert update.is_whole
    row, column = update.frame.cells_of(place[None])[0]
    return int(update.states[row, column])


def held_share(body, points):
    return float(np.any([implicit_value(body, i, points) <= 1 + 1e-9 for i in range(len(body))], axis=0).mean())


@given(
    size=st.tuples(*[st.floats(0.03, 1.5)] * 3), power=st.sampled_from([0.2, 1.0, 2.0]), seed=st.integers(0, 99),
    with_sketch=st.booleans(),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_a_stand_in_holds_every_point_with_a_margin(size, power, seed, with_sketch):
    rays = np.random.default_rng(seed).normal(size=(400, 3))
    rays = np.sign(rays) * np.abs(rays) ** power
    points = (rays / np.linalg.norm(rays, axis=1, keepdims=True) * size + [1.0, 2.0, 0.5]).astype(np.float32)
    # Seen from one side only.
    points = points[points[:, 0] < 1.2]
    thing = replace(crate(), points_world=points, colors=np.zeros((len(points), 3), np.uint8))
    thing = replace(thing, sketch=sketch(points, thing.box) if with_sketch else None)
    body = stand_in_of(thing)
    steps = [side * MARGIN_M * axis for axis in body.world_from_local[0, :3, :3].T for side in (-1, 1)]
    for step in [np.zeros(3), *steps]:
        assert held_share(body, points + step) == 1.0


def points_of(*sides):
    """Points 2 cm apart in boxes: (low, high) each."""
    grids = [np.meshgrid(*[np.arange(a, b + 1e-9, 0.02) for a, b in zip(*side, strict=True)]) for side in sides]
    return np.concatenate([np.stack(grid, axis=-1).reshape(-1, 3) for grid in grids])


def seen_as(points):
    box = gravity_aligned_box(points, 0.01)
    colors = np.zeros((len(points), 3), np.uint8)
    return replace(crate(), points_world=points.astype(np.float32), colors=colors, box=box)


def test_a_lamp_is_no_pillar():
    lamp = points_of(((0, 0, 0), (0.3, 0.3, 0.02)), ((0.14, 0.14, 0.02), (0.16, 0.16, 1.2)))
    body = stand_in_of(seen_as(lamp))
    assert held_share(body, lamp) == 1.0
    assert held_share(body, np.array([[0.04, 0.04, 0.8]])) == 0.0
    assert volumes_m3(body).sum() < 0.03


def test_the_inside_of_a_half_seen_thing_stays_inside():
    body = stand_in_of(seen_as(points_of(((0, 0, 0), (0.6, 0.0, 0.6)), ((0, 0, 0), (0.0, 0.6, 0.6)))))
    assert held_share(body, points_of(((0.2, 0.2, 0.1), (0.3, 0.3, 0.5)))) == 1.0


def test_a_stand_in_takes_the_smaller_of_box_and_sketch():
    rays = np.random.default_rng(0).normal(size=(2000, 3))
    ball = (rays / np.linalg.norm(rays, axis=1, keepdims=True) * 0.3 + [4.5, 1.0, 0.3]).astype(np.float32)
    thing = replace(crate(), points_world=ball, colors=np.zeros((len(ball), 3), np.uint8))
    boxed = stand_in_of(thing)
    sketched = stand_in_of(replace(thing, sketch=sketch(ball, thing.box)))
    assert volumes_m3(sketched).sum() < 0.8 * volumes_m3(boxed).sum()


@pytest.mark.parametrize("phase", [Phase.TENTATIVE, Phase.ACTIVE, Phase.DORMANT])
def test_in_a_live_run_a_thing_blocks_from_its_first_sighting(phase):
    seen = snapshot(crate(phase))
    assert state_at(Costmap(ROBOT, cell_m=0.05, seen=SeenSurface()), seen, CRATE_AT) == Cell.OCCUPIED


def test_in_a_saved_map_a_hardly_seen_thing_does_not_block():
    assert state_at(Costmap(ROBOT, cell_m=0.05), snapshot(crate()), CRATE_AT) == Cell.FREE


def test_the_real_shape_replaces_the_stand_in_when_it_comes():
    (before,) = early_obstacles([crate(Phase.ACTIVE)])
    finished = crate(Phase.ACTIVE, with_shape=True)
    (after,) = early_obstacles([finished])
    assert before.is_observed_only
    assert not after.is_observed_only
    assert after.body is finished.shape.inflated


def test_a_stand_in_is_remade_only_when_its_object_changed():
    still, moving = crate(), replace(crate(), id=7)
    before = early_obstacles([still, moving])
    grown = replace(moving, points_world=moving.points_world + np.float32(0.1))
    after = early_obstacles([still, grown])
    assert after[0] is before[0]
    assert after[1] is not before[1]
    assert held_share(after[1].body, grown.points_world) == 1.0
    assert [obstacle.id for obstacle in early_obstacles([grown])] == [7]


class Noted:
    """A grid that notes which objects are put into it."""

    def __init__(self, frame):
        self.frame = frame
        self.put_ids = []

    def put(self, object_id, inflated):
        self.put_ids.append(object_id)

    def put_hulls(self, object_id, hulls):
        pass

    def remove(self, object_id):
        pass

    def observe(self, walls, unknown):
        pass


def test_a_stand_in_re_enters_the_grid_only_after_a_change():
    still, moving = crate(), replace(crate(), id=7)
    points = still.points_world
    give_up(still, lambda name: points.copy(), "points_world")  # as those of a run are
    followed = Followed(lambda frame, _: Noted(frame), (0.0, 1.0), cell_m=0.05, seen=SeenSurface())
    grid = followed.update(snapshot(still, moving))
    assert grid.put_ids == [2, 7]
    followed.update(snapshot(still, moving))
    followed.update(snapshot(still, replace(moving, sightings=moving.sightings + 1)))
    assert grid.put_ids == [2, 7, 7]


def test_surface_of_no_track_blocks_until_rays_pass_twice():
    seen, empty = SeenSurface(), snapshot()
    seen.add(surface(surface_cells=cells_of_crate()), empty)
    assert state_at(Costmap(ROBOT, cell_m=0.05, seen=seen), empty, CRATE_AT) == Cell.OCCUPIED
    for expected in (Cell.OCCUPIED, Cell.FREE):
        seen.add(surface(free_cells=cells_of_crate()), empty)
        assert state_at(Costmap(ROBOT, cell_m=0.05, seen=seen), empty, CRATE_AT) == expected


def test_a_thing_that_is_seen_again_is_not_looked_through():
    seen, empty = SeenSurface(), snapshot()
    for _ in range(3):
        seen.add(surface(surface_cells=cells_of_crate()), empty)
        seen.add(surface(free_cells=cells_of_crate()), empty)
    assert state_at(Costmap(ROBOT, cell_m=0.05, seen=seen), empty, CRATE_AT) == Cell.OCCUPIED


def test_the_floor_and_what_is_above_the_robot_do_not_block():
    seen, empty = SeenSurface(), snapshot()
    floor = cells_of_crate() * [1, 1, 0]
    seen.add(surface(surface_cells=np.concatenate([floor, floor + np.array([0, 0, 38])])), empty)
    assert state_at(Costmap(load_robot("jackal"), cell_m=0.05, seen=seen), empty, CRATE_AT) == Cell.FREE


def test_surface_of_an_object_with_layer_four_blocks_once():
    seen = SeenSurface()
    finished = snapshot(crate(Phase.ACTIVE, with_shape=True))
    seen.add(surface(surface_cells=cells_of_crate()), finished)
    assert len(free_space_of(finished, ROBOT, seen=seen).hulls[SEEN_SURFACE]) == 0


def test_surface_stays_with_its_submap_when_that_is_placed_anew():
    seen = SeenSurface()
    seen.add(surface(surface_cells=cells_of_crate()), snapshot())
    moved = np.eye(4)
    moved[0, 3] = -1.0
    moved_snapshot = snapshot(world_from_submap=moved)
    assert state_at(Costmap(ROBOT, cell_m=0.05, seen=seen), moved_snapshot, CRATE_AT) == Cell.FREE
    assert state_at(Costmap(ROBOT, cell_m=0.05, seen=seen), moved_snapshot, CRATE_AT - [1, 0]) == Cell.OCCUPIED


def test_a_planner_avoids_what_was_seen_once():
    start, goal = np.array([3.6, 1.0]), np.array([5.6, 1.0])
    seen = SeenSurface()
    seen.add(surface(surface_cells=cells_of_crate() + np.array([0, 12, 0])), snapshot())
    early = free_space_of(snapshot(crate()), ROBOT, seen=seen)
    late = free_space_of(snapshot(crate()), ROBOT)
    ways = [plan(space, start, goal, SearchConfig(), np.random.default_rng(0)) for space in (early, late)]
    assert all(isinstance(way, Path) for way in ways)
    straight = np.array([start, goal])
    assert is_verified(late, straight, np.zeros(1, np.int64))
    assert not is_verified(early, straight, np.zeros(1, np.int64))
    through_the_unnamed = straight + np.array([0.0, 0.6])
    assert not is_verified(early, through_the_unnamed, np.zeros(1, np.int64))


def test_what_is_in_the_way_is_said_to_be_observed_only():
    seen = SeenSurface()
    seen.add(surface(surface_cells=cells_of_crate() + np.array([0, 30, 0])), snapshot())
    space = free_space_of(snapshot(crate()), ROBOT, seen=seen)
    assert blockers_at(space, CRATE_AT)[0].text == "object 2 (observed only), which is there"
    assert blockers_at(space, CRATE_AT + np.array([0, 1.5]))[0].text == "something seen, which is there"
    answer = plan(space, np.array([3.6, 1.0]), CRATE_AT, SearchConfig(), np.random.default_rng(0))
    assert "observed only" in answer.text
    assert VOXEL_M == 0.05  # the cells above are so large
