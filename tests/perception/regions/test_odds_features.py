import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.perception.affinity.pixel_network import (
    NUM_OUTPUTS,
    ODDS_UNIT,
    ODDS_ZERO,
    OFFSETS,
    THING,
    PixelOdds,
)
from hickory_stream.perception.regions.fragment_odds import fragment_odds
from hickory_stream.perception.regions.odds_features import ODDS_FEATURES, odds_features


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


def test_the_networks_favourite_partner_is_known_from_the_others():
    found = said([[1, 2], [2, 3]])
    assert found["large_odds_below_best"].tolist() == [0.0, 7.0]
    assert found["small_odds_below_best"].tolist() == [0.0, 0.0]


def test_of_things_and_of_what_is_none_the_network_tells_apart():
    found = said([[2, 3]])
    assert (found["large_thing_odds"].tolist(), found["small_thing_odds"].tolist()) == ([3.0], [-2.0])


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


def test_of_no_pairs_nothing_is_said():
    for odds in (None, fragment_odds(*columns())):
        assert all(values.shape == (0,) for values in odds_features(odds, np.zeros((0, 2), np.int64), 4).values())


@given(st.integers(0, 2**32 - 1))
def test_features_of_groups_are_those_of_the_groups_as_fragments(seed):
    rng = np.random.default_rng(seed)
    labels = np.kron(rng.permutation(np.arange(30) % 8 + 1).reshape(5, 6), np.ones((8, 8), int)).astype(np.int32)
    odds = PixelOdds(odds=rng.integers(0, 256, (NUM_OUTPUTS, 20, 24)).astype(np.uint8))
    numbers = np.append([0, 1, 2, 3], rng.integers(1, 4, 5))
    pairs = np.array([[1, 2], [3, 1], [2, 3]])
    grouped = odds_features(fragment_odds(labels, odds).of_groups(numbers, 4), pairs, 4)
    alone = odds_features(fragment_odds(numbers[labels].astype(np.int32), odds), pairs, 4)
    for name, values in grouped.items():
        np.testing.assert_array_equal(values, alone[name], err_msg=name)
