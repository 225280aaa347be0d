"""Checked, read-only arrays: every record makes its array fields so on construction."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray


def frozen_array(values: Any, dtype: DTypeLike, shape: tuple[int | None, ...], name: str) -> NDArray[Any]:
    """Return `values` as a read-only, C-contiguous array of `dtype`; `None` in `shape` is any length.

    An array that is so already is returned; others are copied, so that nobody keeps a writable reference.

    Raises:
        ValueError: the shape does not fit, or `dtype` cannot hold the values; losing digits of a float is no reason.
    """
    array = _converted(values, dtype, name)
    _check_shape(array, shape, name)
    if not array.flags.writeable and array.flags.c_contiguous:
        return array
    array = np.array(array, dtype=dtype, order="C")
    array.flags.writeable = False
    return array


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only, C-contiguous view, a copy where need be: kernels are compiled for one kind of array."""
    if array.flags.c_contiguous and not array.flags.writeable:
        return array
    view = np.ascontiguousarray(array)[...]
    view.flags.writeable = False
    return view


def freeze(record: object, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> None:
    """Replace an array field of a frozen dataclass by its checked read-only form (for `__post_init__`)."""
    label = f"{type(record).__name__}.{name}"
    object.__setattr__(record, name, frozen_array(getattr(record, name), dtype, shape, label))


def freeze_all(record: object, dtype: DTypeLike, **shapes: tuple[int | None, ...]) -> None:
    """`freeze` array fields of one dtype, by their shapes."""
    for name, shape in shapes.items():
        freeze(record, name, dtype, shape)


def check_array(record: object, name: str, dtype: DTypeLike, shape: tuple[int | None, ...]) -> None:
    """Raise ValueError if a record's array is of another type or shape; the array stays (for `__post_init__`)."""
    label, array = f"{type(record).__name__}.{name}", getattr(record, name)
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        raise ValueError(f"{label} is of {getattr(array, 'dtype', type(array).__name__)}; expected {np.dtype(dtype)}")
    _check_shape(array, shape, label)


def _check_shape(array: NDArray[Any], shape: tuple[int | None, ...], name: str) -> None:
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(want is not None and have != want for have, want in zip(array.shape, shape, strict=True))
    ):
        wanted = ", ".join("any" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} has shape {array.shape}; expected ({wanted})")


def _converted(values: Any, dtype: DTypeLike, name: str) -> NDArray[Any]:
    given = np.asarray(values)
    if given.dtype == dtype:
        return given
    if np.can_cast(given.dtype, dtype, "same_kind"):
        return np.asarray(given, dtype=dtype)
    # Lists of Python numbers and foreign integer types are welcome as long as no value changes.
    refusal = f"{name} has values of {given.dtype} that {np.dtype(dtype)} cannot hold; convert them first"
    try:
        with np.errstate(invalid="ignore"):
            array = given.astype(dtype)
    except (ValueError, TypeError) as error:
        raise ValueError(refusal) from error
    if not np.array_equal(array, given):
        raise ValueError(refusal)
    return array
