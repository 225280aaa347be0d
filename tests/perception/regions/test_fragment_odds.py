import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.perception.affinity.pixel_network import (
    DISTANCES_PX,
    NUM_OUTPUTS,
    ODDS_UNIT,
    ODDS_ZERO,
    OFFSETS,
    THING,
    PixelOdds,
)
from hickory_stream.perception.regions.fragment_odds import fragment_odds
from hickory_stream.perception.regions.odds_features import ODDS_FEATURES, odds_features


def constant_odds(height, width, value):
    return PixelOdds(odds=np.full((NUM_OUTPUTS, height, width), ODDS_ZERO + value, np.uint8))


def halves():
    labels = np.ones((64, 64), np.int32)
    labels[:, 32:] = 2
    return labels


def test_the_mean_odds_of_two_halves_are_those_of_their_pixels():
    odds = fragment_odds(halves(), constant_odds(32, 32, 24))
    sums, levels = odds.of_pairs(np.array([[2, 1]]), 3)
    counts = levels.sum(axis=2)
    assert (counts > 0).all()
    np.testing.assert_array_equal(sums, 24 * counts)
    np.testing.assert_array_equal(odds.inner, 24 * odds.num_inner)
    np.testing.assert_array_equal(odds.thing, 24 * odds.num_pixels)


def test_pairs_of_pixels_are_counted_by_the_networks_certainty():
    for i, byte in enumerate((ODDS_ZERO - 3 * ODDS_UNIT, ODDS_ZERO - 1, ODDS_ZERO, ODDS_ZERO + 2 * ODDS_UNIT)):
        levels = fragment_odds(halves(), constant_odds(32, 32, byte - ODDS_ZERO)).levels[0]
        assert (levels[:, i] > 0).all()
        assert (np.delete(levels, i, axis=1) == 0).all()


def test_every_pair_of_pixels_across_a_seam_counts_once():
    labels = halves()
    odds = fragment_odds(labels, constant_odds(32, 32, 1))
    few = labels[::2, ::2]
    expected = 0
    for dy, dx in OFFSETS:
        here = few[: 32 - dy, max(0, -dx) : 32 - max(0, dx)]
        there = few[dy:, max(0, dx) : 32 + min(0, dx)]
        expected += int((here != there).sum())
    assert odds.levels.sum(axis=2)[0].sum() == odds.sums.sum() == expected
    within = sum(int((few[: 32 - d] == few[d:]).sum() + (few[:, : 32 - d] == few[:, d:]).sum()) for d in DISTANCES_PX)
    assert expected < within < odds.num_inner.sum()


def test_fragments_that_no_pair_of_pixels_links_are_not_told_of():
    labels = np.zeros((400, 400), np.int32)
    labels[:4, :4], labels[-4:, -4:] = 1, 2
    odds = fragment_odds(labels, constant_odds(200, 200, 5))
    assert len(odds.a) == 0
    sums, levels = odds.of_pairs(np.array([[1, 2]]), 3)
    assert not sums.any()
    assert not levels.any()


@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
def test_the_sums_of_groups_are_those_of_what_they_are_made_of(seed, num_groups):
    rng = np.random.default_rng(seed)
    labels = np.kron(rng.integers(0, 9, (5, 6)), np.ones((8, 8), int)).astype(np.int32)
    odds = PixelOdds(odds=rng.integers(0, 256, (NUM_OUTPUTS, 20, 24)).astype(np.uint8))
    numbers = rng.integers(1, num_groups, 9)
    numbers[0] = 0
    grouped = fragment_odds(labels, odds).of_groups(numbers[: labels.max() + 1], num_groups)
    joined = fragment_odds(numbers[labels].astype(np.int32), odds)
    for name in ("a", "b", "sums", "levels"):
        np.testing.assert_array_equal(getattr(grouped, name), getattr(joined, name))
    for name in ("inner", "num_inner", "thing", "num_pixels"):
        found = getattr(grouped, name)
        count = len(getattr(joined, name))
        np.testing.assert_array_equal(found[:count], getattr(joined, name))
        assert not found[count:].any()


def test_the_thing_output_is_told_of_each_fragment():
    odds = constant_odds(32, 32, 0)
    odds.odds[THING, :, 16:] = ODDS_ZERO + 2 * ODDS_UNIT
    found = fragment_odds(halves(), odds)
    assert (found.thing / np.maximum(found.num_pixels, 1)).tolist() == [0.0, 0.0, 2.0 * ODDS_UNIT]


def columns():
    """Return three columns of pixels, 1, 2 and 3, and what is said of them: 1 and 2 are one, 3 is another thing."""
    labels = np.ones((64, 96), np.int32)
    labels[:, 32:64], labels[:, 64:] = 2, 3
    odds = np.full((NUM_OUTPUTS, 32, 48), ODDS_ZERO + 3 * ODDS_UNIT, np.uint8)
    few = labels[::2, ::2]
    for i, (dy, dx) in enumerate(OFFSETS):
        other = np.roll(few, (-dy, -dx), axis=(0, 1))
        odds[i][(few == 3) != (other == 3)] = ODDS_ZERO - 4 * ODDS_UNIT
    odds[THING, :, 32:] = ODDS_ZERO - 2 * ODDS_UNIT
    return labels, PixelOdds(odds=odds)


def said(pairs):
    return odds_features(fragment_odds(*columns()), np.array(pairs), 4)


def test_mean_odds_and_shares_tell_what_is_one_from_what_is_two():
    found = said([[1, 2], [3, 2]])
    for name in ("odds_near", "odds_far", "odds_at_1", "odds_at_27"):
        assert found[name].tolist() == [3.0, -4.0]
    assert found["odds_near_apart"].tolist() == found["odds_far_below_even"].tolist() == [0.0, 1.0]
    assert found["odds_near_one"].tolist() == [1.0, 0.0]
    assert found["large_odds_within"].tolist() == found["small_odds_far_within"].tolist() == [3.0, 3.0]


def test_the_networks_favourite_partner_and_things_are_known():
    found = said([[1, 2], [2, 3]])
    assert found["large_odds_below_best"].tolist() == [0.0, 7.0]
    assert found["small_odds_below_best"].tolist() == [0.0, 0.0]
    assert (found["large_thing_odds"][1], found["small_thing_odds"][1]) == (3.0, -2.0)


def test_what_the_network_does_not_say_is_nan_and_no_warning():
    labels, odds = columns()
    labels[:, 32:64] = 0
    found = odds_features(fragment_odds(labels[:, :96], odds), np.array([[1, 2], [1, 3]]), 4)
    assert np.isnan(found["odds_near"]).all()
    assert np.isnan(found["odds_at_9"]).all()
    assert np.isnan(found["small_thing_odds"][0])
    nothing = odds_features(None, np.array([[1, 2], [1, 3]]), 4)
    assert tuple(nothing) == tuple(found) == ODDS_FEATURES
    assert all(np.isnan(values).all() and values.shape == (2,) for values in nothing.values())
    for some in (None, fragment_odds(*columns())):
        assert all(values.shape == (0,) for values in odds_features(some, np.zeros((0, 2), np.int64), 4).values())
