"""Clouds that nobody looks at are kept compressed: a fifth to a half of their memory, and the same to the byte.

A cloud whose arrays were packed stays the same object; whoever reads one of its arrays gets it as it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
import zstandard

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from numpy.typing import NDArray

NAMES = ("keys", "points", "colors", "hits")

_lock = RLock()
_cold: WeakKeyDictionary[Any, _Packed] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class _Packed:
    """The arrays of a cloud of `count` points, and what gives them back."""

    count: int
    arrays: Callable[[], Mapping[str, NDArray[Any]]]


def pack(cloud: Any) -> None:
    """Compress the arrays of a cloud."""
    with _lock:
        if cloud not in _cold and len(cloud.keys):
            packed = [_compressed(getattr(cloud, name)) for name in NAMES]
            _keep(cloud, _Packed(len(cloud.keys), lambda: dict(zip(NAMES, map(_restored, packed), strict=True))))


def pack_part(part: Any, whole: Any) -> None:
    """Let go of the arrays of a cloud that are some of another one's, which is packed as well.

    Where they are not some of those the part is compressed by itself.
    """
    with _lock:
        if part in _cold or part is whole:
            return pack(whole)
        marks = np.isin(whole.keys, part.keys, assume_unique=True)
        chosen = {name: getattr(whole, name)[marks] for name in NAMES}
        if all(np.array_equal(chosen[name], getattr(part, name)) for name in NAMES):
            bits, count = np.packbits(marks), len(marks)

            def arrays() -> Mapping[str, NDArray[Any]]:
                kept = np.unpackbits(bits, count=count).astype(bool)
                return {name: array[kept] for name, array in _arrays_of(whole).items()}

            _keep(part, _Packed(len(part.keys), arrays))
        else:
            pack(part)
        return pack(whole)


def unpacked(cloud: Any, name: str) -> NDArray[Any]:
    """Return an array of a cloud that was packed, which has all of them again.

    Raises:
        AttributeError: it is no array of a cloud.
    """
    if name not in NAMES:
        raise AttributeError(name)
    with _lock:
        packed = _cold.get(cloud)
        if packed is not None:
            for array_name, restored in packed.arrays().items():
                object.__setattr__(cloud, array_name, restored)
            del _cold[cloud]
    array: NDArray[Any] = object.__getattribute__(cloud, name)
    return array


def count_of(cloud: Any) -> int:
    """Return the number of points of a cloud, without unpacking it."""
    packed = _cold.get(cloud)
    return len(cloud.keys) if packed is None else packed.count


def is_packed(cloud: Any) -> bool:
    """Return whether the arrays of a cloud are compressed."""
    return cloud in _cold


def _arrays_of(cloud: Any) -> Mapping[str, NDArray[Any]]:
    """Return the arrays of a cloud, which stays packed if it is."""
    packed = _cold.get(cloud)
    return {name: getattr(cloud, name) for name in NAMES} if packed is None else packed.arrays()


def _keep(cloud: Any, packed: _Packed) -> None:
    _cold[cloud] = packed
    for name in NAMES:
        object.__delattr__(cloud, name)


def _compressed(array: NDArray[Any]) -> tuple[str, tuple[int, ...], bytes]:
    """Return an array packed byte by byte: the first bytes of all numbers, then the second ones, ...; keys as steps."""
    steps = np.diff(array, prepend=array.dtype.type(0)) if array.ndim == 1 else array
    columns = np.ascontiguousarray(steps.reshape(len(array), -1).T)
    planes = columns.reshape(-1).view(np.uint8).reshape(-1, array.dtype.itemsize).T.tobytes()
    return array.dtype.str, array.shape, zstandard.compress(planes, 1)


def _restored(packed: tuple[str, tuple[int, ...], bytes]) -> NDArray[Any]:
    name, shape, data = packed
    dtype = np.dtype(name)
    planes = np.frombuffer(zstandard.decompress(data), np.uint8).reshape(dtype.itemsize, -1)
    columns = np.ascontiguousarray(planes.T).reshape(-1).view(dtype).reshape(-1, shape[0])
    if len(shape) == 1:
        return np.cumsum(columns[0], dtype=dtype)
    return np.ascontiguousarray(columns.T).reshape(shape)
