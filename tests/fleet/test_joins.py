import numpy as np
import pytest
from hickory_stream.fleet.growth import GrownMap, Round
from hickory_stream.fleet.joins import JoinEvent, Joins, joined_since
from hickory_stream.geometry.rigid import invert
from tests.alignment.map_fixtures import frame, furniture, snapshot_of

ITEMS = furniture(16, 7)
FRAMES = {"a": np.eye(4), "b": frame(70, 2, -1), "c": frame(-130, 0.5, 3), "far": frame(20, 1, 1)}
OTHER_PLACE = furniture(12, 60)


def seen(name, first, last):
    items = OTHER_PLACE if name == "far" else ITEMS
    return snapshot_of(items[first:last], FRAMES[name], ord(name[0]))


def rounds(joins, *steps):
    """Return what holds after each step, in which robots have seen a range of the objects."""
    maps = {}
    found = []
    for i, step in enumerate(steps, start=1):
        for name, span in step.items():
            poses = np.empty((0, 4, 4))
            maps[name] = GrownMap(keyframes=i, snapshot=seen(name, *span), extractor="", world_from_camera=poses)
        ordered = {name: maps[name] for name in FRAMES if name in maps}
        found.append(joins.update(Round(keyframe=i, maps=ordered, grown=tuple(step))))
    return found


def names(joint):
    return [frame.names for frame in joint.frames]


@pytest.fixture(scope="module")
def grown():
    """Three robots of which a and b see the same from the first round on, c from the second, and one elsewhere."""
    everybody = {"a": (0, 12), "b": (3, 15), "c": (12, 14), "far": (0, 12)}
    return rounds(Joins(), everybody, everybody | {"c": (2, 14)}, everybody | {"c": (2, 16)})


def test_two_answers_in_a_row_join_robots_where_they_truly_are(grown):
    assert names(grown[0]) == [("a",), ("b",), ("c",), ("far",)]
    assert names(grown[1]) == [("a", "b"), ("c",), ("far",)]
    assert names(grown[2]) == [("a", "b", "c"), ("far",)]
    told = [(event.keyframe, event.kind, event.a, event.b) for joint in grown for event in joint.events]
    assert told == [(2, "joined", "a", "b"), (3, "joined", "a", "c"), (3, "joined", "b", "c")]
    assert all(event.num_pairs >= 8 and 0 < event.sigma_m < 0.1 for joint in grown for event in joint.events)
    joined = grown[2].frames[0]
    for name, pose in zip(joined.names, joined.frame_from_robot, strict=True):
        assert np.allclose(pose, invert(FRAMES[name]), atol=0.02)
    alone = grown[2].frames[1]
    assert np.array_equal(alone.frame_from_robot[0], np.eye(4))
    assert alone.pairs == ()


def test_a_join_is_withdrawn_when_a_later_answer_is_another_one(monkeypatch):
    joins = Joins()
    both = {"a": (0, 12), "b": (0, 12)}
    assert names(rounds(joins, both, both)[-1]) == [("a", "b")]
    # b was carried away: the same objects stand elsewhere in its frame.
    monkeypatch.setitem(FRAMES, "b", frame(-20, 9, 4))
    moved = rounds(joins, both, both)
    assert names(moved[0]) == [("a",), ("b",)]
    assert [event.kind for event in moved[0].events] == ["withdrawn"]
    assert names(moved[1]) == [("a", "b")]
    assert np.allclose(moved[1].frames[0].frame_from_robot[1], invert(FRAMES["b"]), atol=0.02)


def test_a_join_counts_from_when_it_holds_for_good():
    def event(keyframe, kind):
        return JoinEvent(keyframe=keyframe, kind=kind, a="a", b="b", a_from_b=np.eye(4), num_pairs=5, sigma_m=0.01)

    first, gone, again = event(3, "joined"), event(6, "withdrawn"), event(9, "joined")
    assert joined_since((first,), "b", "a") == 3
    assert joined_since((first, gone), "a", "b") is None
    assert joined_since((first, gone, again), "a", "b") == 9
    assert joined_since((first,), "a", "c") is None
