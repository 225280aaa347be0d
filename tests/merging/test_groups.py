from dataclasses import replace
from itertools import combinations
import numpy as np
import pytest
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.object_map import object_map
from hickory_stream.geometry.rigid import invert
from hickory_stream.merging.groups import groups_of
from tests.alignment.map_fixtures import frame, furniture, snapshot_of

HERE, THERE = furniture(12, 7), furniture(12, 60)
FRAMES = (frame(20, 1, 1), frame(70, 2, -1), frame(-130, 0.5, 3), frame(10, 4, 0), frame(33, 0, 2))
PLACES = (furniture(9, 90), HERE, THERE, HERE, THERE)

Answers = dict[tuple[int, int], Alignment | NoAlignment]


@pytest.fixture(scope="module")
def maps():
    """Five maps: the first of a place of its own, two each of two others."""
    return [snapshot_of(items, pose, i) for i, (items, pose) in enumerate(zip(PLACES, FRAMES, strict=True))]


@pytest.fixture(scope="module")
def answers(maps):
    objects = [object_map(snapshot) for snapshot in maps]
    return {(a, b): align(objects[a], objects[b]) for a, b in combinations(range(len(maps)), 2)}


def test_each_place_is_a_group_also_where_the_first_map_is_alone(maps, answers):
    found = groups_of(maps, answers)
    assert [group.members for group in found] == [(0,), (1, 3), (2, 4)]
    assert [group.pairs for group in found] == [(), ((1, 3),), ((2, 4),)]
    for group in found:
        for member, pose in zip(group.members, group.group_from_map, strict=True):
            assert np.allclose(pose, FRAMES[group.members[0]] @ invert(FRAMES[member]), atol=0.02)


@pytest.fixture(scope="module")
def here():
    """Four maps of one place, and their alignments, which are right."""
    maps = [snapshot_of(HERE[:8], pose, i) for i, pose in enumerate(FRAMES[:4])]
    objects = [object_map(snapshot) for snapshot in maps]
    found = {(a, b): align(objects[a], objects[b]) for a, b in combinations(range(len(maps)), 2)}
    return maps, {pair: answer for pair, answer in found.items() if isinstance(answer, Alignment)}


def with_a_wrong_one(here, count, bad):
    """Return some of the maps, and their alignments: one two metres off, and a little weaker than it was."""
    maps, answers = here
    right = answers[bad]
    wrong = replace(right, a_from_b=frame(0, 2, 0) @ right.a_from_b, log10_chance=right.log10_chance + 1)
    return maps[:count], {pair: answer for pair, answer in answers.items() if max(pair) < count} | {bad: wrong}


@pytest.mark.parametrize("bad", [(0, 1), (2, 3)])
def test_an_alignment_that_the_others_contradict_joins_nothing(here, bad):
    maps, answers = with_a_wrong_one(here, 4, bad)
    assert len(answers) == 6
    (group,) = groups_of(maps, answers)
    assert group.members == (0, 1, 2, 3)
    assert set(group.pairs) == answers.keys() - {bad}
    for true, pose in zip(FRAMES, group.group_from_map, strict=False):
        assert np.allclose(pose, FRAMES[0] @ invert(true), atol=0.02)


@pytest.mark.parametrize("bad", [(0, 1), (0, 2), (1, 2)])
def test_a_ring_of_three_that_does_not_close_joins_nobody(here, bad):
    """Any of the three may be the wrong one."""
    maps, answers = with_a_wrong_one(here, 3, bad)
    assert [group.members for group in groups_of(maps, answers)] == [(0,), (1,), (2,)]


def test_without_answers_every_map_is_alone(maps):
    assert [group.members for group in groups_of(maps, {})] == [(0,), (1,), (2,), (3,), (4,)]
