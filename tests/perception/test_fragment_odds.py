import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hickory_stream.perception.fragment_odds import FragmentOdds, averaged, fragment_odds
from hickory_stream.perception.pixel_network import NUM_OUTPUTS, ODDS_UNIT, ODDS_ZERO, OFFSETS, THING, PixelOdds


def constant_odds(height, width, value):
    return PixelOdds(odds=np.full((NUM_OUTPUTS, height, width), ODDS_ZERO + value, np.uint8))


def halves():
    labels = np.ones((64, 64), np.int32)
    labels[:, 32:] = 2
    return labels


def three(near, num_near=(1, 1, 1)):
    """Return the odds of three fragments: near sums of 1-2, 1-3, 2-3."""
    none = np.zeros(3, np.int64)
    return FragmentOdds(
        a=np.array([1, 1, 2]),
        b=np.array([2, 3, 3]),
        near=np.array(near, np.int64),
        num_near=np.array(num_near, np.int64),
        far=none,
        num_far=none,
        thing=np.zeros(4, np.int64),
        num_pixels=np.ones(4, np.int64),
    )


def test_the_mean_odds_of_two_halves_are_those_of_their_pixels():
    odds = fragment_odds(halves(), constant_odds(32, 32, 24))
    near, far = odds.means_of(np.array([[2, 1]]), 3)
    assert near[0] == far[0] == 24 / ODDS_UNIT
    assert odds.thing_means()[1:] == pytest.approx(24 / ODDS_UNIT)


def test_every_pair_of_pixels_across_a_seam_counts_once():
    labels = halves()
    odds = fragment_odds(labels, constant_odds(32, 32, 1))
    few = labels[::2, ::2]
    expected = 0
    for dy, dx in OFFSETS:
        here = few[: 32 - dy, max(0, -dx) : 32 - max(0, dx)]
        there = few[dy:, max(0, dx) : 32 + min(0, dx)]
        expected += int((here != there).sum())
    assert odds.num_near[0] + odds.num_far[0] == odds.near[0] + odds.far[0] == expected


def test_fragments_that_no_pair_of_pixels_links_are_not_told_of():
    labels = np.zeros((400, 400), np.int32)
    labels[:4, :4], labels[-4:, -4:] = 1, 2
    odds = fragment_odds(labels, constant_odds(200, 200, 5))
    assert len(odds.a) == 0
    near, far = odds.means_of(np.array([[1, 2]]), 3)
    assert np.isnan([near[0], far[0]]).all()


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
def test_the_sums_of_groups_are_those_of_what_they_are_made_of(seed, num_groups):
    rng = np.random.default_rng(seed)
    labels = np.kron(rng.integers(0, 9, (5, 6)), np.ones((8, 8), int)).astype(np.int32)
    odds = PixelOdds(odds=rng.integers(0, 256, (NUM_OUTPUTS, 20, 24)).astype(np.uint8))
    numbers = rng.integers(1, num_groups, 9)
    numbers[0] = 0
    grouped = fragment_odds(labels, odds).of_groups(numbers[: labels.max() + 1], num_groups)
    joined = fragment_odds(numbers[labels].astype(np.int32), odds)
    for name in ("near", "num_near", "far", "num_far"):
        of_pairs = ({(a, b): v for a, b, v in zip(o.a, o.b, getattr(o, name), strict=True)} for o in (grouped, joined))
        assert next(of_pairs) == next(of_pairs)
    np.testing.assert_array_equal(grouped.thing[: len(joined.thing)], joined.thing)


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
    odds = three([-ODDS_UNIT, -9 * ODDS_UNIT, -9 * ODDS_UNIT])
    far = FragmentOdds(
        a=odds.a,
        b=odds.b,
        near=odds.near,
        num_near=odds.num_near,
        far=np.array([8 * ODDS_UNIT, 0, 0]),
        num_far=np.array([4, 0, 0]),
        thing=odds.thing,
        num_pixels=odds.num_pixels,
    )
    assert averaged(far, 0.0, 0.0).tolist() == [0, 1, 2, 3]
    assert averaged(far, 0.0, 1.0).tolist() == [0, 1, 1, 2]


def test_the_thing_output_is_told_of_each_fragment():
    odds = constant_odds(32, 32, 0)
    odds.odds[THING, :, 16:] = ODDS_ZERO + 2 * ODDS_UNIT
    assert fragment_odds(halves(), odds).thing_means()[1:].tolist() == [0.0, 2.0]
