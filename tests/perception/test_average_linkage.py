import numpy as np

from hickory_stream.perception.average_linkage import averaged
from hickory_stream.perception.fragment_odds import FragmentOdds
from hickory_stream.perception.pixel_network import ODDS_UNIT


def three(near, num_near=(1, 1, 1), far=(0, 0, 0), num_far=(0, 0, 0)):
    """Return the odds of three fragments: sums of 1-2, 1-3, 2-3 at the least distance and at the greatest one."""
    sums, levels = np.zeros((3, 4), np.int64), np.zeros((3, 4, 4), np.int64)
    sums[:, 0], levels[:, 0, 1] = near, num_near
    sums[:, 3], levels[:, 3, 2] = far, num_far
    within = np.zeros((4, 4), np.int64)
    return FragmentOdds(
        a=np.array([1, 1, 2]),
        b=np.array([2, 3, 3]),
        sums=sums,
        levels=levels,
        inner=within,
        num_inner=within,
        thing=np.zeros(4, np.int64),
        num_pixels=np.ones(4, np.int64),
    )


def test_average_linkage_joins_the_likeliest_first_and_asks_the_mean_of_what_is_left():
    # 1 and 2 are joined; their mean odds with 3 are (2 - 6) / 2 < 0, although 1 alone would be joined with it.
    numbers = averaged(three([5 * ODDS_UNIT, 2 * ODDS_UNIT, -6 * ODDS_UNIT]), 0.0, 1.0)
    assert numbers.tolist() == [0, 1, 1, 2]


def test_many_pairs_of_pixels_outweigh_few():
    numbers = averaged(three([5 * ODDS_UNIT, 20 * ODDS_UNIT, -6 * ODDS_UNIT], (1, 10, 1)), 0.0, 1.0)
    assert numbers.tolist() == [0, 1, 1, 1]


def test_nothing_is_joined_below_the_least_odds():
    assert averaged(three([8, 8, 8]), 1.0, 1.0).tolist() == [0, 1, 2, 3]


def test_far_odds_count_by_their_weight():
    far = three([-ODDS_UNIT, -9 * ODDS_UNIT, -9 * ODDS_UNIT], far=(8 * ODDS_UNIT, 0, 0), num_far=(4, 0, 0))
    assert averaged(far, 0.0, 0.0).tolist() == [0, 1, 2, 3]
    assert averaged(far, 0.0, 1.0).tolist() == [0, 1, 1, 2]
