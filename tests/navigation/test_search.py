import itertools
from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import InputError
from hickory_stream.navigation.berth import keep_off, passed_by
from hickory_stream.navigation.clearance import ClearanceScene
from hickory_stream.navigation.free_space import free_space_of, without_layer_four
from hickory_stream.navigation.robot import Part, Posture, Robot, load_robot, robot_of
from hickory_stream.navigation.search import NoPath, NoPathReason, Path, SearchConfig, first_path, plan
from hickory_stream.records import MapSnapshot, Phase
from tests.navigation.rooms import TABLE_AT, boxes, seen_room, snapshot, table, tracked

START, GOAL = np.array([0.7, 0.6]), np.array([5.3, 3.4])
POINT = load_robot("point")


def answer_of(space, start=START, goal=GOAL, **config):
    return plan(space, np.array(start), np.array(goal), SearchConfig(**config))


@pytest.fixture(scope="module")
def room():
    return snapshot(tracked(1, table()), tracked(2, boxes(((4.5, 1.0, 0.3), (0.4, 0.3, 0.3)))))


@pytest.fixture(scope="module")
def space(room):
    return free_space_of(room, POINT)


def assert_touches_nothing(path, room, robot):
    """Points of the body, every 2 cm of the way and while it turns, against the superquadrics and the voxels."""
    scene = ClearanceScene()
    for item in room.objects:
        scene.put(item.id, item.shape.inflated)
    scene.observe(room.submaps[0].observed_space)
    rng = np.random.default_rng(5)
    before = path.headings_rad[0]
    for i, (a, b) in enumerate(itertools.pairwise(path.points)):
        posture = robot.postures[path.postures[i]]
        turn = (path.headings_rad[i] - before + np.pi) % (2 * np.pi) - np.pi
        # The side of the turn that was free is not told: only turns of less than a quarter have one that is obvious.
        spots = [(a, before + share * turn) for share in np.linspace(0, 1, 10) if abs(turn) < np.pi / 2]
        steps = np.linspace(0, 1, max(int(np.linalg.norm(b - a) / 0.02), 2))
        spots += [(a + share * (b - a), path.headings_rad[i]) for share in steps]
        before = path.headings_rad[i]
        for place, heading in spots:
            for part in posture.parts:
                weights = rng.dirichlet(np.full(len(part.corners_m), 0.4), 60)
                angle = rng.uniform(0, 2 * np.pi, 60)
                flat = weights @ part.corners_m + part.disc_m * np.stack([np.cos(angle), np.sin(angle)], axis=1)
                c, s = np.cos(heading), np.sin(heading)
                flat = flat @ np.array([[c, s], [-s, c]]) + place
                points = np.column_stack([flat, rng.uniform(part.low_m, part.high_m, 60)])
                assert (scene.classify(points) == 0).all()


@pytest.mark.parametrize("planner", ["rrt", "rrt-connect", "rrt-star"])
def test_every_planner_finds_a_free_path_through_the_door(space, room, planner):
    path = answer_of(space, planner=planner)
    assert np.array_equal(path.points[0], START)
    assert np.array_equal(path.points[-1], GOAL)
    assert_touches_nothing(path, room, POINT)
    # Through the door, near (3, 1.5): no shorter than by way of it.
    direct = np.linalg.norm(START - [3.0, 1.6]) + np.linalg.norm(GOAL - [3.0, 1.6])
    assert direct - 0.1 < path.length_m < direct + 0.25
    assert np.array_equal(answer_of(space, planner=planner).points, path.points)


def test_a_path_ducks_under_the_table_where_the_body_fits(room):
    start, goal = (TABLE_AT[0], 0.6), (TABLE_AT[0], 3.4)
    path = answer_of(free_space_of(room, POINT), start, goal)
    assert path.length_m == pytest.approx(2.8)
    two = {
        "posture": [
            {"name": "up", "low_m": 0.05, "high_m": 1.0, "radius_m": 0.15},
            {"name": "down", "low_m": 0.05, "high_m": 0.5, "radius_m": 0.15, "cost": 1.2},
        ]
    }
    robot = robot_of(two)
    path = answer_of(free_space_of(room, robot), start, goal)
    assert sorted(set(path.postures.tolist())) == [0, 1]
    assert_touches_nothing(path, room, robot)
    tall = replace(robot, postures=robot.postures[:1])
    around = answer_of(free_space_of(room, tall), start, goal)
    assert around.length_m > 3.0
    # Three times as dear, it is not worth it but for cutting a corner.
    dear = replace(robot, postures=(robot.postures[0], replace(robot.postures[1], cost=3.0)))
    found = answer_of(free_space_of(room, dear), start, goal)
    assert found.length_m > 3.0
    assert found.cost_m < around.length_m + 1e-6


def test_a_long_robot_turns_to_pass_the_door_and_touches_nothing(room):
    robot = load_robot("jackal")
    path = answer_of(free_space_of(room, robot, cell_m=0.05))
    assert_touches_nothing(path, room, robot)
    through = [(a, b) for a, b in itertools.pairwise(path.points) if min(a[0], b[0]) <= 3.0 <= max(a[0], b[0])]
    assert len(through) == 1
    narrow = free_space_of(snapshot(space=seen_room(door_m=(1.8, 2.15))), robot, cell_m=0.05)
    assert answer_of(narrow).reason is NoPathReason.UNREACHABLE


def test_every_reason_for_no_path_is_told_apart(space, room):
    def reason(answer):
        assert answer.text
        return answer.reason

    inside = (4.5, 1.0)
    assert reason(answer_of(space, start=inside)) is NoPathReason.START_IN_COLLISION
    assert reason(answer_of(space, goal=inside)) is NoPathReason.GOAL_IN_COLLISION
    assert first_path(space, np.array(inside), GOAL, np.random.default_rng(0)) is None
    closed = free_space_of(snapshot(space=seen_room(door_m=(9.0, 9.0))), POINT)
    assert reason(answer_of(closed)) is NoPathReason.UNREACHABLE
    dark = snapshot(space=seen_room(dark_m=(4.0, 5.0)))
    assert reason(answer_of(free_space_of(dark, POINT), goal=(4.5, 2.0))) is NoPathReason.GOAL_UNKNOWN
    assert reason(answer_of(free_space_of(dark, POINT), start=(4.5, 2.0))) is NoPathReason.START_UNKNOWN
    assert reason(answer_of(free_space_of(dark, POINT))) is NoPathReason.UNREACHABLE
    assert isinstance(answer_of(free_space_of(dark, POINT, unknown="free")), Path)
    assert reason(answer_of(space, planner="rrt", max_iterations=3)) is NoPathReason.BUDGET


def test_a_request_that_cannot_be_meant_is_refused(space, room):
    with pytest.raises(InputError, match=r"the goal \(50, 1\) is outside of the map"):
        answer_of(space, goal=(50.0, 1.0))
    with pytest.raises(InputError, match="expected two finite coordinates"):
        answer_of(space, start=(np.nan, 1.0))
    with pytest.raises(InputError, match="the map is empty"):
        free_space_of(MapSnapshot(revision=0, stamp_ns=0, submaps=(), objects=()), POINT)
    with pytest.raises(InputError, match=r"reaches 5.00 m from its middle; the map is only 4.1"):
        part = Part(low_m=0.05, high_m=1.0, disc_m=5.0)
        free_space_of(room, Robot(name="giant", postures=(Posture(name="upright", parts=(part,)),)))
    with pytest.raises(InputError, match="expected one of rrt, rrt-connect, rrt-star"):
        SearchConfig(planner="prm")


def test_an_object_without_layer_4_is_avoided_by_its_box(room):
    bare = replace(room, objects=(tracked(1, table(), with_shape=False),))
    assert without_layer_four(bare) == [1]
    assert without_layer_four(room) == []
    assert answer_of(free_space_of(bare, POINT), goal=TABLE_AT).reason is NoPathReason.GOAL_IN_COLLISION
    hardly_seen = replace(bare, objects=(replace(bare.objects[0], phase=Phase.TENTATIVE),))
    assert isinstance(answer_of(free_space_of(hardly_seen, POINT), goal=TABLE_AT), Path)


def test_an_object_that_goes_gives_its_place_back(room):
    space = free_space_of(room, POINT)
    before = space.blocked().mean()
    space.remove(2)
    assert space.blocked().mean() < before
    assert isinstance(answer_of(space, goal=(4.5, 1.0)), Path)
    space.put(2, room.objects[1].shape.inflated)
    assert space.blocked().mean() == before


CHAIR = tracked(4, boxes(((1.5, 2.6, 0.4), (0.25, 0.25, 0.4))))
BESIDE_CHAIR, PAST_CHAIR = np.array([0.5, 2.2]), np.array([2.4, 2.2])


def planned(berth_m, start=BESIDE_CHAIR, goal=PAST_CHAIR):
    made = snapshot(CHAIR, space=seen_room())
    space = free_space_of(made, load_robot("jackal"))
    keep_off(space, made, [4], berth_m)
    return plan(space, start, goal)


def away_m(way):
    """Return how near the path's line comes to the chair's box, as seen from above."""
    return next(d for d in np.arange(0.0, 3.0, 0.01) if passed_by(way.points, snapshot(CHAIR), [4], d))


@pytest.mark.parametrize("berth_m", [0.0, 0.15, 0.3])
def test_a_way_keeps_as_far_off_as_it_is_told(berth_m):
    way = planned(berth_m)
    # The jackal's narrow side is 0.215 m from its centre.
    assert away_m(way) >= berth_m + 0.2


def test_where_there_is_no_room_for_a_berth_it_says_so():
    beside = np.array([1.5, 2.05])
    assert isinstance(planned(0.0, beside), Path)
    assert isinstance(planned(0.6, beside), NoPath)


def test_only_what_is_asked_for_is_near():
    way = np.array([[0.5, 2.2], [2.4, 2.2]])
    made = snapshot(CHAIR)
    assert passed_by(way, made, [4], 0.16) == [4]
    assert passed_by(way, made, [4], 0.14) == []
    assert passed_by(way, made, [], 3.0) == []
    assert passed_by(way[:1], made, [4], 3.0) == [4]
