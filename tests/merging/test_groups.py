from dataclasses import replace
from itertools import combinations
import numpy as np
import pytest
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment, Refusal
from hickory_stream.alignment.object_map import object_map, taken
from hickory_stream.geometry.rigid import invert
from hickory_stream.merging.groups import groups_of
from hickory_stream.merging.joining import JoiningConfig, aligned_to_join
from hickory_stream.merging.layout import Relation, odometry, solve
from tests.alignment.map_fixtures import frame, furniture, snapshot_of
from tools.evaluation.simulated_maps.simulate import SimulationConfig, simulate_pair

HERE, THERE = furniture(12, 7), furniture(12, 60)
FRAMES = (frame(20, 1, 1), frame(70, 2, -1), frame(-130, 0.5, 3), frame(10, 4, 0), frame(33, 0, 2))
PLACES = (furniture(9, 90), HERE, THERE, HERE, THERE)


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


TRUE = [frame(0, 0, 0), frame(30, 4, 1), frame(-50, 2, 6), frame(170, -3, 2)]


def relation(a, b, a_from_b=None, strength=10.0):
    return Relation(
        a=a, b=b, a_from_b=invert(TRUE[a]) @ TRUE[b] if a_from_b is None else a_from_b, covariance=np.eye(6) * 1e-4,
        center_a=np.array([1.0, 2.0, 0.5]), strength=strength,
    )  # fmt: skip


def test_maps_are_laid_out_along_their_alignments():
    solved = solve(4, [], [relation(0, 1), relation(2, 1), relation(2, 3)])
    assert solved.is_believed == (True, True, True)
    for pose, true in zip(solved.root_from_node, TRUE, strict=True):
        assert np.allclose(pose, true, atol=1e-4)


@pytest.mark.parametrize("wrong_at", [0, 2, 5])
def test_an_alignment_that_the_others_contradict_is_rejected(wrong_at):
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    relations = [relation(a, b) for a, b in pairs]
    relations[wrong_at] = relation(*pairs[wrong_at], a_from_b=frame(80, 1, -4))
    solved = solve(4, [], relations)
    assert [i for i, holds in enumerate(solved.is_believed) if not holds] == [wrong_at]
    for pose, true in zip(solved.root_from_node, TRUE, strict=True):
        assert np.allclose(pose, true, atol=1e-2)


def test_odometry_is_never_doubted():
    step = invert(TRUE[0]) @ TRUE[1]
    wrong = frame(90, 0, 3)
    solved = solve(2, [odometry(0, 1, step)], [relation(0, 1, a_from_b=wrong)])
    assert solved.is_believed == (False,)
    assert np.allclose(solved.root_from_node[1], step, atol=1e-2)


def test_what_hangs_on_nothing_is_left_out():
    solved = solve(4, [], [relation(0, 1), relation(2, 3)])
    assert [pose is not None for pose in solved.root_from_node] == [True, True, False, False]
    assert solved.is_believed == (True, False)
    assert [pose is not None for pose in solve(3, [], []).root_from_node] == [True, False, False]
    others = solve(4, [], [relation(0, 1), relation(2, 3)], root=2)
    assert [pose is not None for pose in others.root_from_node] == [False, False, True, True]
    assert np.allclose(others.root_from_node[3], invert(TRUE[2]) @ TRUE[3], atol=1e-4)


def test_maps_are_joined_only_beyond_chance():
    pair = simulate_pair(SimulationConfig(difficulty="easy"), 3)
    answer = align(pair.map_a, pair.map_b)
    assert answer.log10_chance < JoiningConfig().max_log10_chance
    joined = aligned_to_join(pair.map_a, pair.map_b)
    assert joined.a_from_b.tobytes() == answer.a_from_b.tobytes()
    surer = JoiningConfig(max_log10_chance=answer.log10_chance - 0.1)
    too_weak = aligned_to_join(pair.map_a, pair.map_b, surer)
    assert too_weak.refusal is Refusal.CHANCE
    assert too_weak.reason.startswith(f"{len(answer.pairs)} pairs agree, but less than 0.000000001 such sets of pairs")


def test_what_align_refuses_is_refused_for_its_reason():
    pair = simulate_pair(SimulationConfig(difficulty="easy"), 3)
    two = taken(pair.map_b, np.arange(2))
    nothing = aligned_to_join(pair.map_a, two)
    assert nothing.refusal is Refusal.TOO_FEW_OBJECTS
