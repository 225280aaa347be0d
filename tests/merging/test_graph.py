import numpy as np
import pytest
from hickory_stream.geometry.rigid import invert
from hickory_stream.merging.layout import Relation, odometry, solve
from tests.alignment.map_fixtures import frame

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
        assert pose is not None
        assert np.allclose(pose, true, atol=1e-4)


@pytest.mark.parametrize("wrong_at", [0, 2, 5])
def test_an_alignment_that_the_others_contradict_is_rejected(wrong_at):
    pairs = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]
    relations = [relation(a, b) for a, b in pairs]
    relations[wrong_at] = relation(*pairs[wrong_at], a_from_b=frame(80, 1, -4))
    solved = solve(4, [], relations)
    assert [i for i, holds in enumerate(solved.is_believed) if not holds] == [wrong_at]
    for pose, true in zip(solved.root_from_node, TRUE, strict=True):
        assert pose is not None
        assert np.allclose(pose, true, atol=1e-2)


def test_odometry_is_never_doubted():
    step = invert(TRUE[0]) @ TRUE[1]
    wrong = frame(90, 0, 3)
    solved = solve(2, [odometry(0, 1, step)], [relation(0, 1, a_from_b=wrong)])
    assert solved.is_believed == (False,)
    assert solved.root_from_node[1] is not None
    assert np.allclose(solved.root_from_node[1], step, atol=1e-2)


def test_what_hangs_on_nothing_is_left_out():
    solved = solve(4, [], [relation(0, 1), relation(2, 3)])
    assert [pose is not None for pose in solved.root_from_node] == [True, True, False, False]
    assert solved.is_believed == (True, False)
    assert [pose is not None for pose in solve(3, [], []).root_from_node] == [True, False, False]
    others = solve(4, [], [relation(0, 1), relation(2, 3)], root=2)
    assert [pose is not None for pose in others.root_from_node] == [False, False, True, True]
    assert others.root_from_node[3] is not None
    assert np.allclose(others.root_from_node[3], invert(TRUE[2]) @ TRUE[3], atol=1e-4)
