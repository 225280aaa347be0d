from dataclasses import replace
import numpy as np
import pytest
from hickory_stream.errors import ConfigError
from hickory_stream.evaluation.truth import instances_of, load_truth, mesh_of
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.room import furnished_room
from hickory_stream.worlds.scene import part_boxes, shared_volume_m3
from tools.worlds.days import CHANGES_A_DAY, world_of_day
from tools.worlds.recording_config import RecordingConfig


def test_a_day_moves_removes_adds_and_exchanges_and_ids_stay():
    world = furnished_room(31, 0)
    today = world_of_day(world, 31, 1, lambda _: True)
    before, after = ({item.id: item for item in one.objects} for one in (world, today))
    both = before.keys() & after.keys()
    moved = [i for i in both if before[i].world_from_object.tolist() != after[i].world_from_object.tolist()]
    gone, new = before.keys() - after.keys(), after.keys() - before.keys()
    assert moved and gone and new
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


def test_equal_days_are_equal_worlds_and_days_follow_each_other():
    world = furnished_room(31, 0)

    def places(one):
        return {item.id: item.world_from_object.tolist() for item in one.objects}

    first, again, second = (places(world_of_day(world, 31, day, lambda _: True)) for day in (1, 1, 2))
    assert first == again
    assert places(world_of_day(world, 31, 0, lambda _: True)) == places(world)
    assert len([i for i in first if second.get(i) == first[i]]) > len(first) / 2


def test_scenes_without_days_and_bad_changes_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("tools.worlds.days._ATTEMPTS", 2)
    with pytest.raises(ConfigError, match="leaves room to walk"):
        world_of_day(furnished_room(31, 0), 31, 1, lambda _: False)
    for options, complaint in (
        ({"scene": "outdoor", "day": 1}, "day 1 in the scene outdoor"),
        ({"scene": "outdoor", "change_at_s": 3.0}, "change at 3"),
        ({"change_at_s": 0.0}, "a time above 0"),
    ):
        with pytest.raises(ConfigError, match=complaint):
            RecordingConfig(**options)
    late = RecordingConfig(scene="room", seed=31, seconds=4.0, rate_hz=1.0, change_at_s=1e4)
    with pytest.raises(ConfigError, match="before the end"):
        make_recording(late, tmp_path, "late", caster=None)


def test_a_world_that_changes_on_the_way_shows_it(tmp_path):
    config = RecordingConfig(scene="room", seed=31, seconds=16.0, rate_hz=1.0, width=96, height=64)
    stayed = make_recording(config, tmp_path, "stayed", caster=None)
    truth = make_recording(replace(config, change_at_s=8.0), tmp_path, "changed", caster=None)
    again = load_truth(truth.folder)
    assert stayed.change is None
    assert again.change.stamp_ns == truth.frames[8].stamp_ns
    before = {item.id: item for item in again.change.before}
    at_end = {item.id: item for item in again.objects}
    was = {item.id: item for item in stayed.objects}
    # What the change names was there before as it says, and is elsewhere or gone at the end; all else is as it was.
    assert before
    for i, item in was.items():
        is_changed = i not in at_end or not np.array_equal(item.world_from_object, at_end[i].world_from_object)
        assert is_changed == (i in before)
        if is_changed:
            assert np.array_equal(before[i].world_from_object, item.world_from_object)
            assert mesh_of(again, before[i]).vertices.shape == mesh_of(stayed, item).vertices.shape
    assert set(at_end) - set(was)
    # Pictures are the same until then, and show what came only afterwards.
    for k in range(16):
        one, other = (instances_of(each, each.frames[k]) for each in (stayed, again))
        assert np.array_equal(one, other) or k >= 8
    for item in again.objects:
        if item.id not in was:
            assert all(frame >= 8 for frame in item.frames)
    for i in set(was) - set(at_end):
        assert all(frame < 8 for frame in before[i].frames)
