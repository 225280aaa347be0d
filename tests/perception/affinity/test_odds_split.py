import numpy as np
import pytest
from hickory_stream.perception.affinity.odds_split import SplitConfig, divided_by_odds
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS, ODDS_UNIT, ODDS_ZERO, OFFSETS, PixelOdds

HEIGHT, WIDTH = 24, 32
"""Of the network's output; the surface has twice as many pixels."""

DIVIDING = SplitConfig(odds_shift=0.5)


def said_of(things, sure=4.0):
    """The odds of a network that knows what each of its pixels shows."""
    odds = np.full((NUM_OUTPUTS, HEIGHT, WIDTH), ODDS_ZERO, np.uint8)
    for i, (dy, dx) in enumerate(OFFSETS):
        for y in range(HEIGHT - dy):
            for x in range(max(0, -dx), WIDTH - max(0, dx)):
                sign = 1 if things[y, x] == things[y + dy, x + dx] else -1
                odds[i, y, x] = ODDS_ZERO + sign * round(sure * ODDS_UNIT)
    return PixelOdds(odds=odds)


def partition(labels):
    """The labels numbered in the order in which they come."""
    _, first, place = np.unique(labels, return_index=True, return_inverse=True)
    return np.argsort(np.argsort(first))[place].reshape(labels.shape)


@pytest.fixture
def three_in_a_row():
    things = np.zeros((HEIGHT, WIDTH), np.int32)
    things[4:20, 2:11], things[4:20, 11:20], things[4:20, 20:30] = 1, 2, 3
    return things


def test_three_things_flush_in_a_row_are_three_fragments(three_in_a_row):
    labels = np.repeat(np.repeat((three_in_a_row > 0).astype(np.int32), 2, axis=0), 2, axis=1)
    divided = divided_by_odds(labels, said_of(three_in_a_row), DIVIDING)
    assert divided.max() == 3
    assert ((divided > 0) == (labels > 0)).all()
    # Between two pixels of the network either is right.
    np.testing.assert_array_equal(partition(divided[::2, ::2]), partition(three_in_a_row))


def test_the_first_piece_keeps_its_number_and_whole_ones_stay(three_in_a_row):
    few = np.where(three_in_a_row == 3, 2, (three_in_a_row > 0).astype(np.int32))
    labels = np.repeat(np.repeat(few, 2, axis=0), 2, axis=1).astype(np.int32)
    divided = divided_by_odds(labels, said_of(three_in_a_row), DIVIDING)
    assert divided.max() == 3
    assert (divided[labels == 2] == 2).all()
    assert set(np.unique(divided[labels == 1])) == {1, 3}


def test_where_the_network_knows_nothing_no_fragment_is_divided(three_in_a_row):
    labels = np.repeat(np.repeat((three_in_a_row > 0).astype(np.int32), 2, axis=0), 2, axis=1)
    even = PixelOdds(odds=np.full((NUM_OUTPUTS, HEIGHT, WIDTH), ODDS_ZERO, np.uint8))
    np.testing.assert_array_equal(divided_by_odds(labels, even, DIVIDING), labels)


def test_odds_shifted_beyond_the_network_divide_nothing(three_in_a_row):
    labels = np.repeat(np.repeat((three_in_a_row > 0).astype(np.int32), 2, axis=0), 2, axis=1)
    odds = said_of(three_in_a_row, sure=2.0)
    np.testing.assert_array_equal(divided_by_odds(labels, odds, SplitConfig(odds_shift=2.5)), labels)
    assert divided_by_odds(labels, odds, SplitConfig(odds_shift=1.5)).max() == 3
    np.testing.assert_array_equal(divided_by_odds(labels, odds, SplitConfig()), labels)


def test_a_too_small_piece_stays_with_its_surroundings(three_in_a_row):
    small, large = np.ones((HEIGHT, WIDTH), np.int32), np.ones((HEIGHT, WIDTH), np.int32)
    small[10:12, 10:12] = large[10:12, 10:13] = 2
    labels = np.ones((2 * HEIGHT, 2 * WIDTH), np.int32)
    assert divided_by_odds(labels, said_of(small), SplitConfig(odds_shift=0.5)).max() == 1
    assert divided_by_odds(labels, said_of(large), SplitConfig(odds_shift=0.5)).max() == 2


def test_no_fragments_are_divided_into_none():
    none = np.zeros((2 * HEIGHT, 2 * WIDTH), np.int32)
    even = PixelOdds(odds=np.full((NUM_OUTPUTS, HEIGHT, WIDTH), ODDS_ZERO, np.uint8))
    np.testing.assert_array_equal(divided_by_odds(none, even, DIVIDING), none)


def test_surfaces_of_odd_size_are_divided_to_their_last_pixel(three_in_a_row):
    labels = np.repeat(np.repeat((three_in_a_row > 0).astype(np.int32), 2, axis=0), 2, axis=1)
    labels[8:40, 60:63] = 1
    odd = np.ascontiguousarray(labels[:-1, :-1])
    divided = divided_by_odds(odd, said_of(three_in_a_row), DIVIDING)
    assert ((divided > 0) == (odd > 0)).all()
