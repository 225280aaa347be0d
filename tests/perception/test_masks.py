import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hickory_stream.perception.masks import enlarged, enlarged_mask


@given(st.integers(1, 4), st.integers(0, 3), st.integers(0, 3), st.integers(0, 2**32 - 1))
def test_what_is_enlarged_repeats_pixels_and_is_nothing_beyond(factor, more_x, more_y, seed):
    labels = np.random.default_rng(seed).integers(0, 3, (4, 5)).astype(np.int32)
    size = (5 * factor + min(more_x, factor - 1), 4 * factor + min(more_y, factor - 1))
    expected = np.zeros((size[1], size[0]), dtype=np.int32)
    expected[: 4 * factor, : 5 * factor] = labels.repeat(factor, axis=0).repeat(factor, axis=1)
    assert np.array_equal(enlarged(labels, factor, size), expected)
    assert np.array_equal(enlarged_mask(labels == 1, factor, size), expected == 1)
