import zlib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hickory_stream.geometry.codecs.color_code import packed_means, unpacked_means
from hickory_stream.geometry.codecs.packing import planes_of
from tests.strategies import seeds


def running_means(rng, count, most_hits):
    """Return means as clouds have them: of one colour after another, rounded to float32 each time."""
    hits = rng.integers(1, most_hits + 1, count)
    means = rng.integers(0, 256, (count, 3)).astype(np.float32)
    for i in range(1, most_hits):
        more = (means.astype(np.float64) * i + rng.integers(0, 256, (count, 3))) / (i + 1)
        means = np.where((hits > i)[:, None], more.astype(np.float32), means)
    return means


@given(seeds, st.integers(0, 80), st.integers(1, 40))
def test_means_come_back_to_the_bit(seed, count, most_hits):
    means = running_means(np.random.default_rng(seed), count, most_hits)
    read = unpacked_means(packed_means(means), count)
    assert read.dtype == np.float32
    assert read.tobytes() == means.tobytes()


@given(hnp.arrays(np.float32, st.tuples(st.integers(0, 30), st.just(3))), seeds)
def test_what_is_no_mean_is_kept_among_means_or_refused(other, seed):
    means = running_means(np.random.default_rng(seed), 2 * len(other), 9)
    for array in (np.concatenate([means[: len(other)], other, means[len(other) :]]), other):
        data = packed_means(array)
        if data is not None:
            assert unpacked_means(data, len(array)).tobytes() == array.tobytes()


def test_means_take_less_than_their_bytes_and_directions_do_not():
    rng = np.random.default_rng(0)
    means = running_means(rng, 3000, 12)
    data = packed_means(means)
    assert len(data) == 10 * 3000
    assert len(zlib.compress(data)) < 0.8 * len(zlib.compress(planes_of(means)))
    directions = rng.normal(size=(3000, 3)).astype(np.float32)
    assert packed_means(directions) is None
    assert packed_means(np.abs(directions)) is None


@pytest.mark.parametrize("change", [lambda data: data[:-1], lambda data: data + b"\0", lambda data: data[:20]])
def test_fewer_or_more_bytes_are_refused(change):
    means = running_means(np.random.default_rng(2), 5, 3)
    means[2] = np.nan
    data = packed_means(means)
    with pytest.raises(ValueError, match="5 mean colours in"):
        unpacked_means(change(data), 5)


@given(st.binary(max_size=60), st.integers(0, 6))
def test_foreign_bytes_give_colours_or_are_refused(data, count):
    try:
        assert unpacked_means(data, count).shape == (count, 3)
    except ValueError:
        pass
