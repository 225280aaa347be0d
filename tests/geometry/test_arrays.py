import pickle
from dataclasses import replace
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from hickory_stream.geometry import lazy_arrays
from hickory_stream.geometry.arrays import frozen_array
from hickory_stream.records import ObservedSpace


def test_a_frozen_array_is_read_only_contiguous_and_a_copy():
    array = frozen_array([[1, 2], [3, 4]], np.float32, (2, 2), "x")
    assert array.dtype == np.float32
    assert array.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        array[0, 0] = 9
    original = np.zeros(3)
    frozen = frozen_array(original, np.float64, (3,), "x")
    original[:] = 7
    assert frozen.tolist() == [0, 0, 0]


def test_a_frozen_array_is_copied_only_to_become_contiguous():
    frozen = frozen_array(np.arange(4), np.int64, (4,), "x")
    assert frozen_array(frozen, np.int64, (None,), "x") is frozen
    turned = frozen_array(np.arange(6).reshape(2, 3), np.int64, (2, 3), "x").T
    again = frozen_array(turned, np.int64, (3, 2), "x")
    assert again.flags.c_contiguous
    assert np.array_equal(again, turned)


@pytest.mark.parametrize("shape", [(3, 2), (2,), (None, 4), (2, 3, 1), ()])
def test_a_wrong_shape_is_refused_with_found_and_expected(shape):
    with pytest.raises(ValueError, match=r"Thing\.x has shape \(2, 3\); expected \("):
        frozen_array(np.zeros((2, 3)), np.float64, shape, "Thing.x")


def test_any_length_fits_none_even_zero():
    assert frozen_array(np.zeros((0, 3)), np.float32, (None, 3), "x").shape == (0, 3)


@pytest.mark.parametrize(("values", "dtype"), [
    ([300], np.uint8), ([-1], np.uint8), ([1.5], np.int32), ([np.nan], np.int64), ([255], np.bool_),
    (["a"], np.float32),
], ids=["too large", "negative", "a fraction", "NaN", "no truth value", "text"])  # fmt: skip
def test_values_that_the_type_cannot_hold_are_refused(values, dtype):
    with pytest.raises(ValueError, match=r"Thing\.x"):
        frozen_array(np.array(values), dtype, (1,), "Thing.x")


@pytest.mark.parametrize(
    ("values", "dtype"),
    [([3, 255], np.uint8), ([2.0, 3.0], np.int32), ([0, 1], np.bool_), ([0.1, 0.2], np.float32), ([1, 2], np.float64)],
    ids=["bytes", "whole numbers", "truth values", "rounded", "counted"],
)
def test_values_that_the_type_can_hold_are_converted(values, dtype):
    assert np.allclose(frozen_array(np.array(values), dtype, (2,), "x"), values)


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
    read = lazy_arrays.restored(lazy_arrays.compressed(array))
    assert (read.dtype, read.shape, read.tobytes()) == (array.dtype, array.shape, array.tobytes())


def test_an_array_that_was_given_up_is_made_each_time_it_is_read():
    record, made = space(), []

    def make(name):
        made.append(name)
        return FREE.copy()

    lazy_arrays.give_up(record, make, "free")
    assert lazy_arrays.has_given_up(record)
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
        lazy_arrays.compress(record, "free", "structure")
    kept = at_hand.free
    with lazy_arrays.read_briefly(away, at_hand, whole):
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

    lazy_arrays.read_later(record, read, "free", "structure")
    lazy_arrays.compress(record, "free", "structure")
    assert not reads
    with lazy_arrays.read_briefly(record):
        assert np.array_equal(record.free, FREE)
    lazy_arrays.compress(record, "free", "structure")
    # It was let go again: what is asked for now is read once more, and stays.
    assert reads == [1]
    first = record.free
    assert record.free is first
    assert reads == [1, 1]
    lazy_arrays.compress(record, "free", "structure")
    assert record.free is not first
    assert np.array_equal(record.free, FREE)
    assert np.array_equal(record.structure, STRUCTURE)
    assert reads == [1, 1]


def test_arrays_that_are_read_later_are_read_once_and_stay():
    record, num_read = space(), []

    def read():
        num_read.append(1)
        return {"free": FREE[1:].copy(), "structure": STRUCTURE[1:].copy()}

    lazy_arrays.read_later(record, read, "free", "structure")
    assert lazy_arrays.has_given_up(record)
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

    lazy_arrays.read_later(record, read, "free", "structure")
    with pytest.raises(OSError, match="gone"):
        assert len(record.free)
    assert np.array_equal(record.free, FREE)


def test_copies_of_a_record_hold_what_it_gave_up():
    record = space()
    lazy_arrays.compress(record, "free", "structure")
    for copied in (replace(record, floor_z_m=1.0), pickle.loads(pickle.dumps(record))):
        assert not lazy_arrays.has_given_up(copied)
        assert np.array_equal(copied.free, FREE)
