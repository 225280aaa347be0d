"""The same room on another day: what differs is what its truth says, and no two things share a place."""

from __future__ import annotations

import numpy as np
import pytest

from hickory_stream.errors import ConfigError
from hickory_stream.worlds.days import CHANGES_A_DAY, world_of_day
from hickory_stream.worlds.recording import RecordingConfig
from hickory_stream.worlds.room import furnished_room
from hickory_stream.worlds.scene import World, part_boxes, shared_volume_m3


def test_a_day_moves_removes_adds_and_exchanges_and_ids_stay() -> None:
    world = furnished_room(31, 0)
    today = world_of_day(world, 31, 1, lambda _: True)
    before, after = ({item.id: item for item in one.objects} for one in (world, today))
    both = before.keys() & after.keys()
    moved = [i for i in both if before[i].world_from_object.tolist() != after[i].world_from_object.tolist()]
    gone, new = before.keys() - after.keys(), after.keys() - before.keys()
    assert moved
    assert gone
    assert new
    assert len(moved) + len(gone) + len(new) <= CHANGES_A_DAY + 2
    assert all(before[i].model is after[i].model for i in both)
    assert min(new) >= 1000
    shifts = [np.linalg.norm(before[i].world_from_object[:3, 3] - after[i].world_from_object[:3, 3]) for i in moved]
    assert min(shifts) > 0.4
    for one in (after[i] for i in (*moved, *new)):
        for other in today.objects:
            if other is not one:
                mine, theirs = (part_boxes(item.model, item.world_from_object) for item in (one, other))
                assert shared_volume_m3(mine, theirs) == 0.0, (one.model.kind, other.model.kind)


def test_the_same_day_is_the_same_world_and_days_follow_one_another() -> None:
    world = furnished_room(31, 0)

    def places(one: World) -> dict[int, list[list[float]]]:
        return {item.id: item.world_from_object.tolist() for item in one.objects}

    first, again, second = (places(world_of_day(world, 31, day, lambda _: True)) for day in (1, 1, 2))
    assert first == again
    assert places(world_of_day(world, 31, 0, lambda _: True)) == places(world)
    assert len([i for i in first if second.get(i) == first[i]]) > len(first) / 2


def test_days_without_a_way_through_the_world_and_scenes_without_days_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hickory_stream.worlds.days._ATTEMPTS", 2)
    with pytest.raises(ConfigError, match="leaves room to walk"):
        world_of_day(furnished_room(31, 0), 31, 1, lambda _: False)
    with pytest.raises(ConfigError, match="day 1 in the scene outdoor"):
        RecordingConfig(scene="outdoor", day=1)
