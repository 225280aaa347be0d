import numpy as np
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS, ODDS_UNIT, ODDS_ZERO, THING, PixelOdds
from hickory_stream.perception.network_segmenter import thing_log_odds


def test_a_mask_has_the_mean_odds_of_its_pixels_or_none():
    labels = np.zeros((6, 8), dtype=np.int32)
    labels[:, :4] = 1
    labels[1, 5] = 2  # between the outputs, which are those of even rows and columns
    odds = np.full((NUM_OUTPUTS, 3, 4), ODDS_ZERO, dtype=np.uint8)
    odds[THING, :, 0] = ODDS_ZERO + 2 * ODDS_UNIT
    odds[THING, :, 1] = ODDS_ZERO - 4 * ODDS_UNIT
    np.testing.assert_array_equal(thing_log_odds(labels, PixelOdds(odds=odds)), [0.0, -1.0, np.nan])
