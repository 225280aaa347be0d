import numpy as np
import pytest
from hickory_stream.navigation.berth import keep_off, passed_by
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import NoPath, Path, plan
from tests.navigation.rooms import boxes, seen_room, snapshot, tracked

CHAIR = tracked(4, boxes(((1.5, 2.6, 0.4), (0.25, 0.25, 0.4))))
START, GOAL = np.array([0.5, 2.2]), np.array([2.4, 2.2])


def planned(berth_m, start=START, goal=GOAL):
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
