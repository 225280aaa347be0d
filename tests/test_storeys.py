from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.records import Submap
from hickory_stream.storeys import floor_beneath, floor_of, floors_of, newest_floor_of, on_storey
from tests.navigation.rooms import boxes, seen_room, snapshot, tracked

SPACE = seen_room()


def seen_at(submap_id, floor_m, *, raised_m=0.0):
    pose = np.eye(4)
    pose[2, 3] = raised_m
    return Submap(id=submap_id, world_from_submap=pose, observed_space=replace(SPACE, floor_z_m=floor_m))


def map_of(*submaps):
    lamp = boxes(((1.0, 1.0, 2.3), (0.1, 0.1, 0.2)))
    chair, desk = boxes(((1.0, 1.0, 0.4), (0.2, 0.2, 0.4))), boxes(((2.0, 1.0, 3.2), (0.4, 0.4, 0.4)))
    return replace(snapshot(tracked(1, lamp), tracked(2, chair), tracked(3, desk)), submaps=submaps)


def test_floors_are_those_of_corrected_submaps_without_landings():
    submaps = (seen_at(0, 0.0), seen_at(1, 0.01), seen_at(2, 1.4), seen_at(3, 0.0, raised_m=2.8), seen_at(4, None))
    assert floors_of(map_of(*submaps)) == pytest.approx((0.01, 2.8))
    assert floors_of(map_of(submaps[4])) == ()


def test_a_maps_floor_is_the_most_seen_and_the_newest_is_current():
    building = map_of(seen_at(0, 0.0), seen_at(1, 2.8), seen_at(2, 2.81), seen_at(3, 5.6), seen_at(4, None))
    assert floor_of(building) == 2.8
    assert newest_floor_of(building) == 5.6
    floorless = map_of(seen_at(0, None))
    assert newest_floor_of(floorless) == floor_of(floorless) == pytest.approx(0.0, abs=1e-6)


def test_an_object_stands_on_the_floor_beneath_it():
    lamp, chair, desk = (float(item.box.corners_world()[:, 2].min()) for item in map_of().objects)
    assert [floor_beneath((0.0, 2.8), bottom_m) for bottom_m in (lamp, chair, desk)] == [0.0, 0.0, 2.8]
    assert floor_beneath((1.0, 2.8), chair) == 1.0


def test_a_storey_has_what_reaches_into_it():
    building = map_of(seen_at(0, 0.0), seen_at(1, 2.8))
    assert [item.id for item in on_storey(building, 0.0).objects] == [1, 2]
    assert [item.id for item in on_storey(building, 2.8).objects] == [3]
    assert on_storey(building, 2.8).submaps == building.submaps
    assert [item.id for item in on_storey(map_of(), 0.0).objects] == [1, 2, 3]
