import numpy as np
import pytest
from hickory_stream.geometry.arrays import frozen_array


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


@pytest.mark.parametrize(
    ("values", "dtype"),
    [
        ([300], np.uint8),
        ([-1], np.uint8),
        ([1.5], np.int32),
        ([np.nan], np.int64),
        ([255], np.bool_),
        (["a"], np.float32),
    ],
    ids=["too large", "negative", "a fraction", "NaN", "no truth value", "text"],
)
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
