"""Any record of the mapper as CBOR (RFC 8949), and back, exactly: the content of the journal.

A record is a map of its fields under a tag with its name. Only records of our own packages are made, by their
constructors, and only if every field holds its declared type (`field_types`): the bytes are not trusted.

Arrays are stored for compression: voxel keys as blocks of bits or differences, colours as differences from the ones
before and from green, points at multiples of a step as differences, depth as differences from neighbours, other
numbers byte by byte.
"""

import dataclasses
import importlib
import math
import pkgutil
import types
from collections.abc import Callable, Collection, Mapping
from enum import Enum
from functools import cache, lru_cache
from typing import Any, NamedTuple, Protocol

import cbor2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.codecs.color_code import unpacked_means
from hickory_stream.geometry.codecs.depth_code import packed_depths, unpacked_depths
from hickory_stream.geometry.codecs.packing import array_of, color_planes, colors_of, planes_of
from hickory_stream.geometry.codecs.voxel_blocks import MOST_KEYS, blocks_of, count_in, is_denser, keys_of_blocks
from hickory_stream.geometry.lattice import packed_points, points_of, unpacked_steps
from hickory_stream.journal.field_types import checked_record, field_checks

# Tags of the range "first come, first served" (RFC 8949, 9.2).
_RECORD, _ARRAY, _PART, _MAP, _SET, _ENUM = 39_100, 39_101, 39_102, 39_103, 39_104, 39_105
_PART_BYTES = 1024
_PLAIN, _BITS, _DIFFERENCES, _PLANES, _BLOCKS, _COLORS, _STEPS, _DEPTHS, _MEANS = range(9)
# A pose or less: planes cost time and gain nothing.
_SMALL_BYTES = 192
_BLOCK_BYTES = 16
_MOST_DIMENSIONS = 8
_LEAST, _MOST = int(np.iinfo(np.int64).min), int(np.iinfo(np.int64).max)
_UNCHANGED = {types.NoneType, bool, float, str, bytes}
_AS_IS = {*_UNCHANGED, int}
_DAMAGE = (
    *(cbor2.CBORError, TypeError, ValueError, KeyError, IndexError, AttributeError),
    *(OverflowError, RecursionError, MemoryError),
)


class PartStore(Protocol):
    """Stores large arrays and some records beside the document, so that unchanged ones are not written again."""

    def put(self, part: object, encoded: Callable[[], bytes]) -> tuple[int, int]:
        """Return the place of an array or record; `encoded()` gives the bytes of a new one."""

    def is_part(self, record: object) -> bool:
        """Return whether a record is stored beside the document."""


class PartPlace(NamedTuple):
    """The place of an array, as of `PartStore`."""

    chunk: int
    number: int
    #: None if unknown.
    length: int | None = None


class LateRecords(Protocol):
    """Makes records some of whose arrays, stored beside the document, are read on first use."""

    def arrays_of(self, kind: type) -> tuple[str, ...]:
        """Return the names of a record's arrays that may stay unread."""

    def record(self, kind: type, values: Mapping[str, Any], places: Mapping[str, PartPlace], checks: Any) -> Any:
        """Return a record of `values` and of arrays at `places`. Raises `TypeError`: they are not its fields."""


def encode(value: Any, parts: PartStore | None = None) -> bytes:
    """Return a value of records, arrays, enums, tuples, dicts, sets, numbers and text.

    Raises `TypeError` for others.
    """
    return cbor2.dumps(_plain(value, parts))


def decode(data: bytes, part: Callable[[int, int], Any] | None = None, later: LateRecords | None = None) -> Any:
    """Return the encoded value, lists as tuples; `part` returns a part by its place in a `PartStore`.

    `later` makes records that may leave arrays unread; None: all are read.

    Raises `ValueError`: the bytes are damaged, or hold an unknown record.
    """
    try:
        # Every item takes a byte at least, unless items are shared, which ours never are: a few bytes that expand
        # to more items were crafted to exhaust memory.
        return _Reader(part, later, most_items=len(data)).value(cbor2.loads(data))
    except _DAMAGE as error:
        raise ValueError(f"no record of this version: {error!r}") from error


def part_references(data: bytes, later: LateRecords | None = None) -> list[tuple[int, int]]:
    """Return the places of the parts that an encoded value refers to, in order, without the arrays that `later` leaves.

    Raises `ValueError`: the bytes are damaged.
    """
    found: dict[int, tuple[int, int]] = {}

    def note(tag: cbor2.CBORTag, _is_key: bool) -> _Reference | None:
        if tag.tag == _PART:
            place, number = tag.value[:2]
            found[len(found)] = place, number
            return _Reference(len(found) - 1)
        if tag.tag == _RECORD and later is not None:
            name, fields = tag.value
            for late in later.arrays_of(_record_of(name)):
                if isinstance(left := fields.get(late), _Reference):
                    left_out.add(left.number)
        return None

    left_out: set[int] = set()
    try:
        cbor2.loads(data, tag_hook=note)
    except _DAMAGE as error:
        raise ValueError(f"no record of this version: {error!r}") from error
    return [place for number, place in found.items() if number not in left_out]


class _Reference(NamedTuple):
    number: int


def encode_array(array: NDArray[Any]) -> bytes:
    """Return a single array, encoded."""
    return cbor2.dumps(_array_tag(array))


def _plain(value: Any, parts: PartStore | None) -> Any:
    kind: type = type(value)
    if kind in _AS_IS:
        return value
    if isinstance(value, np.ndarray):
        if parts is None or value.nbytes < _PART_BYTES:
            return _array_tag(value)
        # With its length, which is often needed without the content.
        return cbor2.CBORTag(_PART, [*parts.put(value, lambda: encode_array(value)), len(value)])
    if kind is tuple or kind is list:
        return [item if type(item) in _AS_IS else _plain(item, parts) for item in value]
    if _names_of(kind) is not None:
        if parts is None or not parts.is_part(value):
            return _record_tag(value, parts)
        return cbor2.CBORTag(_PART, list(parts.put(value, lambda: cbor2.dumps(_record_tag(value, parts)))))
    match value:
        case Enum():
            return cbor2.CBORTag(_ENUM, [kind.__name__, value.value])
        case str():
            return str(value)
        case int() | np.integer():
            return int(value)
        case float() | np.floating():
            return float(value)
        case tuple() | list():
            return [_plain(item, parts) for item in value]
        case set() | frozenset():
            return cbor2.CBORTag(_SET, [_plain(item, parts) for item in sorted(value)])
        case _ if hasattr(value, "items"):
            return cbor2.CBORTag(_MAP, [[_plain(key, parts), _plain(item, parts)] for key, item in value.items()])
    raise TypeError(f"a journal holds no {kind.__name__}")


def _record_tag(value: Any, parts: PartStore | None) -> cbor2.CBORTag:
    kind: type = type(value)
    fields = {name: getattr(value, name) for name in _names_of(kind) or ()}
    # Half of all values need no look.
    fields |= {name: _plain(item, parts) for name, item in fields.items() if type(item) not in _AS_IS}
    return cbor2.CBORTag(_RECORD, [kind.__name__, fields])


@cache
def _names_of(kind: type) -> tuple[str, ...] | None:
    if not dataclasses.is_dataclass(kind):
        return None
    assert record_classes().get(kind.__name__) is kind, f"{kind.__name__} is no record of the registry"
    return tuple(field.name for field in dataclasses.fields(kind))


def _array_tag(array: NDArray[Any]) -> cbor2.CBORTag:
    dtype, name = _little(array.dtype)
    little = np.asarray(array, dtype=dtype, order="C")
    method, data = _PLAIN, b""
    if dtype.kind == "b":
        method, data = _BITS, np.packbits(little).tobytes()
    elif little.nbytes < _SMALL_BYTES:
        data = little.tobytes()
    elif little.dtype == np.uint8 and little.ndim == 2 and little.shape[1] == 3:
        method, data = _COLORS, color_planes(little)
    elif little.dtype.itemsize == 1:
        data = little.tobytes()
    elif little.dtype == np.float32 and little.shape[1:] == (3,) and (packed := packed_points(little)) is not None:
        method, data = _STEPS, packed
    elif little.dtype == np.int64 and little.ndim == 1 and is_denser(little):
        heads, words = blocks_of(little)
        method, data = _BLOCKS, planes_of(np.diff(heads, prepend=np.int64(0))) + planes_of(words)
    elif little.dtype == np.int64 and little.ndim == 1:
        method, data = _DIFFERENCES, planes_of(np.diff(little, prepend=np.int64(0)))
    elif little.dtype == np.uint16 and little.ndim == 2:
        method, data = _DEPTHS, np.packbits(little > 0).tobytes() + packed_depths([little])
    else:
        method, data = _PLANES, planes_of(little)
    return cbor2.CBORTag(_ARRAY, [name, list(little.shape), method, data])


@cache
def _little(dtype: np.dtype[Any]) -> tuple[np.dtype[Any], str]:
    little = dtype.newbyteorder("<")
    return little, little.str


class _Reader:
    def __init__(self, part: Callable[[int, int], Any] | None, later: LateRecords | None, most_items: int) -> None:
        self._part = part
        self._later = later
        self._left = most_items

    def value(self, item: Any) -> Any:
        return self._values((item,))[0]

    def _values(self, items: Collection[Any]) -> list[Any]:
        self._left -= len(items)
        if self._left < 0:
            raise ValueError("more items than bytes")
        return [item if type(item) in _UNCHANGED else self._made(item) for item in items]

    def _made(self, item: Any) -> Any:
        if type(item) is int:
            if not _LEAST <= item <= _MOST:
                raise ValueError(f"a number of {item.bit_length()} bits")
            return item
        if isinstance(item, list | tuple):
            return tuple(self._values(item))
        if not isinstance(item, cbor2.CBORTag):
            raise ValueError(f"a journal holds no {type(item).__name__}")
        tag, content = item.tag, item.value
        if tag == _RECORD:
            name, fields = content
            kind = _record_of(name)
            names = () if self._later is None else self._later.arrays_of(kind)
            if self._later is None or not names:
                values = dict(zip(fields, self._values(fields.values()), strict=True))
                return checked_record(kind, values, _checks(kind))
            tags = {name: fields.get(name) for name in names}
            parts = {name: tag for name, tag in tags.items() if isinstance(tag, cbor2.CBORTag) and tag.tag == _PART}
            places = {name: PartPlace(*tag.value) for name, tag in parts.items()}
            values = {key: self.value(entry) for key, entry in fields.items() if key not in places}
            return self._later.record(kind, values, places, _checks(kind))
        if tag == _ARRAY:
            return _array(*content)
        if tag == _PART:
            if self._part is None:
                raise ValueError("the record refers to parts of another one")
            return self._part(*content[:2])
        if tag == _MAP:
            return {self.value(key): self.value(entry) for key, entry in content}
        if tag == _SET:
            return set(self._values(content))
        if tag == _ENUM:
            name, text = content
            return _record_of(name)(text)
        raise ValueError(f"unknown tag {tag}")


def _record_of(name: object) -> Any:
    kind = record_classes().get(name) if isinstance(name, str) else None
    if kind is None:
        raise ValueError(f"there is no record {name!r}")
    return kind


@cache
def _checks(kind: type) -> dict[str, Callable[[Any], bool]]:
    return field_checks(kind, record_classes())


def _array(dtype_name: str, shape: list[int], method: int, data: bytes) -> NDArray[Any]:
    dtype, native = _dtypes(dtype_name)
    if len(shape) > _MOST_DIMENSIONS or not all(type(length) is int and 0 <= length <= _MOST for length in shape):
        raise ValueError(f"an array of shape {shape}")
    count = math.prod(shape)
    # Memory is taken for the claimed shape.
    if method == _DEPTHS:
        if len(shape) != 2 or dtype != np.uint16 or len(data) < -(-count // 8):
            raise ValueError(f"depths of shape {shape} in {len(data)} bytes")
    elif method not in (_BLOCKS, _MEANS) and len(data) != (
        -(-count // 8) if method == _BITS else count * dtype.itemsize
    ):
        raise ValueError(f"an array of shape {shape} in {len(data)} bytes")
    if method == _BLOCKS:
        array = _keys(data, count).astype(dtype)
    elif method == _COLORS and dtype == np.uint8 and tuple(shape[1:]) == (3,):
        array = colors_of(data, shape[0])
    elif method == _STEPS and dtype == np.float32 and tuple(shape[1:]) == (3,):
        array = points_of(unpacked_steps(data, shape[0]))
    elif method == _DEPTHS:
        is_there = np.unpackbits(np.frombuffer(data, np.uint8, -(-count // 8)), count=count).astype(bool)
        (array,) = unpacked_depths(data[-(-count // 8) :], [is_there.reshape(shape)])
    elif method == _MEANS and dtype == np.float32 and tuple(shape[1:]) == (3,):
        array = unpacked_means(data, shape[0])
    elif method == _BITS:
        array = np.unpackbits(np.frombuffer(data, np.uint8), count=count).astype(bool)
    elif method == _PLAIN:
        array = np.frombuffer(data, dtype)
    elif method in (_DIFFERENCES, _PLANES):
        array = array_of(data, dtype, tuple(shape))
        if method == _DIFFERENCES:
            array = np.cumsum(array, dtype=np.int64)
    else:
        raise ValueError(f"unknown storage {method} of an array")
    array = array.reshape(shape).astype(native, copy=False)
    array.flags.writeable = False
    return array


@lru_cache(64)
def _dtypes(name: str) -> tuple[np.dtype[Any], np.dtype[Any]]:
    # As stored (lowest byte first), and as on this processor.
    dtype = np.dtype(name)
    if dtype.kind not in "biuf" or dtype.itemsize > 8:
        raise ValueError(f"a journal holds no arrays of {dtype}")
    return dtype, dtype.newbyteorder("=")


def _keys(data: bytes, count: int) -> NDArray[np.int64]:
    half = len(data) // 2
    # Each block has a key at least, and memory is taken for 64 of each.
    if len(data) % _BLOCK_BYTES or half // 8 > count or count > MOST_KEYS:
        raise ValueError(f"{count} keys in blocks of {len(data)} bytes")
    heads = array_of(data[:half], np.dtype("<i8"), (half // 8,))
    words = array_of(data[half:], np.dtype("<u8"), (half // 8,))
    if count_in(words) != count:
        raise ValueError(f"{count} keys in blocks of {count_in(words)}")
    return keys_of_blocks(np.cumsum(heads, dtype=np.int64), words)


@cache
def record_classes() -> dict[str, Any]:
    """Return all dataclasses and enums of a journal by name."""
    import hickory_stream.geometry
    import hickory_stream.mapping

    names = ["hickory_stream.records", "hickory_stream.events"]
    names += [f"hickory_stream.journal.{name}" for name in ("step", "checkpoints", "snapshot_records", "packed_frames")]
    names += ["hickory_stream.graph.factors"]
    for package in (hickory_stream.geometry, hickory_stream.mapping):
        names += [module.name for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")]
    found: dict[str, Any] = {}
    for name in names:
        for kind in vars(importlib.import_module(name)).values():
            is_record = isinstance(kind, type) and (dataclasses.is_dataclass(kind) or issubclass(kind, Enum))
            # Configurations are in the manifest.
            if is_record and kind.__module__ == name and not kind.__name__.endswith("Config"):
                assert kind.__name__ not in found, f"two records are called {kind.__name__}"
                found[kind.__name__] = kind
    return found
