import pickle
from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hickory_stream.geometry.lazy_arrays import (
    compress,
    compressed,
    give_up,
    has_given_up,
    read_briefly,
    read_later,
    restored,
)
from hickory_stream.records import ObservedSpace

FREE, STRUCTURE = np.arange(5, 500, 3), np.arange(7)


def space():
    return ObservedSpace(voxel_m=0.05, free=FREE, structure=STRUCTURE, floor_z_m=0.0)


@given(
    hnp.arrays(
        dtype=st.sampled_from(["<f4", "<i8", "|u1", "<i4"]),
        shape=hnp.array_shapes(min_dims=1, max_dims=2, min_side=0, max_side=20),
    )
)
def test_a_compressed_array_comes_back_to_the_bit(array):
    read = restored(compressed(array))
    assert (read.dtype, read.shape, read.tobytes()) == (array.dtype, array.shape, array.tobytes())


def test_an_array_that_was_given_up_is_made_each_time_it_is_read():
    record, made = space(), []

    def make(name):
        made.append(name)
        return FREE.copy()

    give_up(record, make, "free")
    assert has_given_up(record)
    assert np.array_equal(record.free, FREE)
    assert np.array_equal(record.free, FREE)
    assert made == ["free", "free"]
    assert record.structure.tolist() == STRUCTURE.tolist()
    with pytest.raises(ValueError, match="read-only"):
        record.free[0] = 1
    assert not hasattr(record, "no_such_array")


def test_a_brief_read_of_a_compressed_array_does_not_keep_it():
    away, at_hand, whole = space(), space(), space()
    for record in (away, at_hand):
        compress(record, "free", "structure")
    kept = at_hand.free
    with read_briefly(away, at_hand, whole):
        first = away.free
        assert away.free is first
        assert at_hand.free is kept
    assert away.free is not first
    assert np.array_equal(away.free, FREE)
    assert at_hand.free is kept
    assert whole.free.tolist() == FREE.tolist()


def test_an_array_to_compress_later_stays_until_it_was_read():
    record, reads = space(), list[int]()

    def read():
        reads.append(1)
        return {"free": FREE.copy(), "structure": STRUCTURE.copy()}

    read_later(record, read, "free", "structure")
    compress(record, "free", "structure")
    assert not reads
    with read_briefly(record):
        assert np.array_equal(record.free, FREE)
    compress(record, "free", "structure")
    # It was let go again: what is asked for now is read once more, and stays.
    assert reads == [1]
    first = record.free
    assert record.free is first
    assert reads == [1, 1]
    compress(record, "free", "structure")
    assert record.free is not first
    assert np.array_equal(record.free, FREE)
    assert np.array_equal(record.structure, STRUCTURE)
    assert reads == [1, 1]


def test_arrays_that_are_read_later_are_read_once_and_stay():
    record, num_read = space(), []

    def read():
        num_read.append(1)
        return {"free": FREE[1:].copy(), "structure": STRUCTURE[1:].copy()}

    read_later(record, read, "free", "structure")
    assert has_given_up(record)
    assert np.array_equal(record.free, FREE[1:])
    assert np.array_equal(record.structure, STRUCTURE[1:])
    assert record.free is record.free
    assert len(num_read) == 1


def test_a_failed_late_read_is_reported_and_may_be_repeated():
    record, failures = space(), [OSError("gone")]

    def read():
        if failures:
            raise failures.pop()
        return {"free": FREE.copy(), "structure": STRUCTURE.copy()}

    read_later(record, read, "free", "structure")
    with pytest.raises(OSError, match="gone"):
        assert len(record.free)
    assert np.array_equal(record.free, FREE)


def test_copies_of_a_record_hold_what_it_gave_up():
    record = space()
    compress(record, "free", "structure")
    for copied in (replace(record, floor_z_m=1.0), pickle.loads(pickle.dumps(record))):
        assert not has_given_up(copied)
        assert np.array_equal(copied.free, FREE)
