"""Clouds that nobody looks at are kept compressed: a fifth to a half of their memory, and the same to the byte.

A cloud whose arrays were packed stays the same object; whoever reads one of its arrays gets it as it was.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import RLock
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np

from hickory_stream.geometry.made_arrays import compressed, in_memory, restored

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.geometry.made_arrays import Keep

NAMES = ("keys", "points", "colors", "hits")

_lock = RLock()
_cold: WeakKeyDictionary[Any, _Packed] = WeakKeyDictionary()


@dataclass(frozen=True, slots=True)
class _Packed:
    """How many points a cloud has (None: its keys say), and what gives each of its arrays back."""

    count: int | None
    array: Callable[[str], NDArray[Any]]


def pack(cloud: Any, keep: Keep = in_memory) -> None:
    """Compress the arrays of a cloud, and have them kept; those of one that was packed before are let go again."""
    with _lock:
        if cloud in _cold:
            _let_go(cloud)
        elif len(cloud.keys):
            packed = {name: compressed(getattr(cloud, name), keep) for name in NAMES}
            _keep(cloud, _Packed(len(cloud.keys), lambda name: restored(packed[name])))


def pack_part(part: Any, whole: Any, keep: Keep = in_memory) -> None:
    """Let go of the arrays of a cloud that are some of another one's, which is packed as well.

    Where they are not some of those the part is compressed by itself.
    """
    with _lock:
        if part in _cold or part is whole:
            pack(part, keep)
            return pack(whole, keep)
        marks = np.isin(whole.keys, part.keys, assume_unique=True)
        chosen = {name: getattr(whole, name)[marks] for name in NAMES}
        if all(np.array_equal(chosen[name], getattr(part, name)) for name in NAMES):
            bits, count = np.packbits(marks), len(marks)

            def chosen_of(name: str) -> NDArray[Any]:
                kept: NDArray[Any] = array_of(whole, name)[np.unpackbits(bits, count=count).astype(bool)]
                return kept

            _keep(part, _Packed(len(part.keys), chosen_of))
        else:
            pack(part, keep)
        return pack(whole, keep)


def leave_unread(cloud: Any, count: int | None, array: Callable[[str], NDArray[Any]]) -> None:
    """Make a cloud of `count` points of which nothing is there.

    `array` gives each of its arrays by its name, when one is looked at.
    """
    with _lock:
        _cold[cloud] = _Packed(count, array)


def unpacked(cloud: Any, name: str) -> NDArray[Any]:
    """Return an array of a cloud that was packed, which has all of them again.

    Raises:
        AttributeError: it is no array of a cloud.
    """
    if name not in NAMES:
        raise AttributeError(name)
    with _lock:
        if is_packed(cloud):
            arrays = {each: _cold[cloud].array(each) for each in NAMES}
            for each, array in arrays.items():
                object.__setattr__(cloud, each, array)
        there: NDArray[Any] = object.__getattribute__(cloud, name)
    return there


def count_of(cloud: Any) -> int:
    """Return the number of points of a cloud, without unpacking it."""
    packed = _cold.get(cloud)
    return len(cloud.keys) if packed is None or packed.count is None else packed.count


def is_packed(cloud: Any) -> bool:
    """Return whether arrays of a cloud are compressed, and not at hand."""
    return cloud in _cold and not all(_is_at_hand(cloud, name) for name in NAMES)


def array_of(cloud: Any, name: str) -> NDArray[Any]:
    """Return an array of a cloud, which stays packed if it is."""
    packed = _cold.get(cloud)
    return getattr(cloud, name) if packed is None or _is_at_hand(cloud, name) else packed.array(name)


def _is_at_hand(cloud: Any, name: str) -> bool:
    try:
        object.__getattribute__(cloud, name)
    except AttributeError:
        return False
    return True


def _keep(cloud: Any, packed: _Packed) -> None:
    _cold[cloud] = packed
    _let_go(cloud)


def _let_go(cloud: Any) -> None:
    for name in NAMES:
        try:
            object.__delattr__(cloud, name)
        except AttributeError:
            pass  # let go before
