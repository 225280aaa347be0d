"""Arrays that a record need not hold: given up, or never read, they are made, equal to the byte, on demand."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from threading import RLock
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import zstandard
from numpy.typing import NDArray

from hickory_stream.geometry.codecs.packing import array_of, planes_of

Make = Callable[[str], NDArray[Any]]
MakeAll = Callable[[], Mapping[str, NDArray[Any]]]
Compressed = tuple[str, tuple[int, ...], Callable[[], bytes]]

Keep = Callable[[bytes], Callable[[], bytes]]
"""Keeps bytes, and returns what gives them back."""


@dataclass(frozen=True, slots=True)
class _Maker:
    # `keeps`: made arrays stay until they are given up again; `is_packed`: from compressed ones; `of`: their inputs.
    make: Callable[[str], Mapping[str, Any]]
    names: tuple[str, ...]
    keeps: bool
    is_packed: bool = False
    of: tuple[object, ...] = ()


_lock = RLock()
_makers: WeakKeyDictionary[Any, _Maker] = WeakKeyDictionary()


class GivesUpArrays:
    """A frozen record, with a slot for weak references, whose arrays may be given up."""

    __slots__ = ()

    def __getattr__(self, name: str) -> Any:
        # Python asks here only for what is not at hand.
        maker = None if name.startswith("__") else _makers.get(self)
        if maker is None or name not in maker.names:
            raise AttributeError(name)
        made = maker.make(name)
        for each, value in made.items():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False
            if maker.keeps:
                object.__setattr__(self, each, value)
        return made[name]


def give_up(record: GivesUpArrays, make: Make, *names: str, of: tuple[object, ...] = ()) -> None:
    """Let go of arrays of a record; `make` gives each by its name, unchanged, and must not hold the record.

    `of`: the immutable objects that alone determine the arrays, for `are_made_alike`.
    """
    _let_go(record, _Maker(lambda name: {name: make(name)}, names, keeps=False, of=of))


def made_of(record: GivesUpArrays) -> tuple[object, ...]:
    """Return the inputs of a record's arrays as given to `give_up`; () if unknown."""
    maker = _makers.get(record)
    return () if maker is None else maker.of


def are_made_alike(a: GivesUpArrays, b: GivesUpArrays) -> bool:
    """Return whether the arrays of two records are known to be made of the same, without making them."""
    of_a, of_b = made_of(a), made_of(b)
    return len(of_a) == len(of_b) > 0 and all(x is y for x, y in zip(of_a, of_b, strict=True))


def read_later(record: GivesUpArrays, read: MakeAll, *names: str) -> None:
    """Have arrays of a record read on first access; then they stay.

    `read` gives all of them by their names, checked, or raises; it must not hold the record.
    """
    read_parts(record, lambda _: read(), *names)


def read_parts(record: GivesUpArrays, read: Callable[[str], Mapping[str, Any]], *names: str) -> None:
    """Have fields of a record read on first access, by `read(name)`, with others read with it; then they stay."""
    _let_go(record, _Maker(read, names, keeps=True))


def in_memory(data: bytes) -> Callable[[], bytes]:
    """Keep bytes, and return a function that gives them back: the simplest `Keep`."""
    return lambda: data


def compress(record: GivesUpArrays, *names: str, keep: Keep = in_memory) -> None:
    """Keep arrays of a record compressed alone; those read since the last time are let go, unread ones stay unread."""
    with _lock:
        maker = _makers.get(record)
        if maker is None or (not maker.is_packed and _is_at_hand(record, maker)):
            packed = {name: compressed(getattr(record, name), keep) for name in names}
            maker = _Maker(lambda name: {name: restored(packed[name])}, names, keeps=True, is_packed=True)
        _let_go(record, maker)


@contextmanager
def read_briefly(*records: GivesUpArrays) -> Iterator[None]:
    """Let go again, after the block, of arrays of records that were compressed, or left unread, before it."""
    with _lock:
        away = [
            (record, maker)
            for record in records
            if (maker := _makers.get(record)) is not None and maker.keeps and not _is_at_hand(record, maker)
        ]
    try:
        yield
    finally:
        for record, maker in away:
            _let_go(record, maker)


def _is_at_hand(record: GivesUpArrays, maker: _Maker) -> bool:
    for name in maker.names:
        try:
            object.__getattribute__(record, name)
        except AttributeError:
            continue
        return True
    return False


def has_given_up(record: GivesUpArrays) -> bool:
    """Return whether arrays of a record are made when they are read."""
    return record in _makers


def _let_go(record: GivesUpArrays, maker: _Maker) -> None:
    with _lock:
        _makers[record] = maker
        for name in maker.names:
            try:
                object.__delattr__(record, name)
            except AttributeError:
                pass  # given up before


def compressed(array: NDArray[Any], keep: Keep = in_memory) -> Compressed:
    """Return an array packed, its bytes where `keep` has them: keys and other whole numbers in a row as steps."""
    if array.size == 0:
        return array.dtype.str, array.shape, in_memory(b"")
    steps = np.diff(array, prepend=array.dtype.type(0)) if _is_row(array) else array
    # A copy: what zstandard returns holds the memory of the most that it could have become.
    return array.dtype.str, array.shape, keep(bytes(memoryview(zstandard.compress(planes_of(steps), 1))))


def restored(packed: Compressed) -> NDArray[Any]:
    """Return the array that was packed."""
    name, shape, data = packed
    dtype = np.dtype(name)
    if 0 in shape:
        return np.empty(shape, dtype)
    array = array_of(zstandard.decompress(data()), dtype, shape)
    return np.cumsum(array, dtype=dtype) if _is_row(array) else array


def _is_row(array: NDArray[Any]) -> bool:
    return array.ndim == 1 and array.dtype.kind in "iu"
