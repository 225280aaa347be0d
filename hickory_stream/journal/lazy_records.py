"""Records of a checkpoint whose arrays are read on first use: most of a large map is never used.

Arrays are read exactly as written; damage is reported at that time.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import MapFolderError
from hickory_stream.geometry.lazy_arrays import read_later
from hickory_stream.journal.checkpoints import PackedTrack
from hickory_stream.journal.field_types import checked_record
from hickory_stream.journal.record_codec import PartPlace
from hickory_stream.mapping.entities.cloud import NAMES, Cloud, array_of, leave_unread
from hickory_stream.mapping.entities.observed_space import SpaceState
from hickory_stream.mapping.entities.submap_surface import SubmapSurface
from hickory_stream.mapping.entities.track import Track
from hickory_stream.records import Keypoints

Checks = Mapping[str, Callable[[Any], bool]]
_Later = Mapping[str, Callable[[], "NDArray[Any]"]]
_ARRAYS: Mapping[type, tuple[str, ...]] = {
    Cloud: NAMES,
    PackedTrack: ("is_solid",),
    SpaceState: ("free", "hidden_free", "surface", "hits", "misses"),
    SubmapSurface: ("keys", "points", "normals", "hits"),
    Keypoints: ("descriptors", "points"),
}


class LazyRecords:
    """Makes records with unread arrays; `read` returns an array of the journal by its place."""

    def __init__(self, read: Callable[[PartPlace], NDArray[Any]], journal: Path) -> None:
        self._read = read
        self._journal = journal

    def arrays_of(self, kind: type) -> tuple[str, ...]:
        """Return the names of a record's arrays that may stay unread."""
        return _ARRAYS.get(kind, ())

    def record(self, kind: type, values: Mapping[str, Any], places: Mapping[str, PartPlace], checks: Checks) -> Any:
        """Return a record with some `values`, and unread arrays at `places`.

        Raises `TypeError` like `checked_record`.
        """
        later = {name: partial(self._read, place) for name, place in places.items()}
        if kind is PackedTrack:
            return self._unpacked(values, later, checks)
        if not later or {field.name for field in fields(kind)} != values.keys() | later.keys():
            return checked_record(kind, {**values, **{name: read() for name, read in later.items()}}, checks)
        record: Any = object.__new__(kind)
        for name, value in values.items():
            if not checks[name](value):
                raise TypeError(f"{kind.__name__}.{name} is of {type(value).__name__}")
            object.__setattr__(record, name, value)
        if kind is Cloud:
            read = {name: values[name] for name in NAMES if name in values}
            count = len(read["keys"]) if "keys" in read else places["keys"].length
            leave_unread(record, count, lambda name: read[name] if name in read else later[name]())
        else:
            read_later(record, lambda: self._whole(kind, values, later, checks), *_ARRAYS[kind])
        return record

    def _whole(self, kind: type, values: Mapping[str, Any], later: _Later, checks: Checks) -> dict[str, NDArray[Any]]:
        with self._as_damage():
            record = checked_record(kind, {**values, **{name: read() for name, read in later.items()}}, checks)
        return {name: getattr(record, name) for name in _ARRAYS[kind]}

    def _unpacked(self, values: Mapping[str, Any], later: _Later, checks: Checks) -> Track:
        track, marks, num_solid = (values.get(name) for name in ("track", "is_solid", "num_solid"))
        is_known = values.keys() | later.keys() == {"track", "is_solid", "num_solid"}
        if not is_known or not isinstance(track, Track) or not checks["num_solid"](num_solid):
            raise TypeError(f"a packed track of {sorted(values)}")
        cloud = track.cloud

        def chosen(name: str) -> NDArray[Any]:
            with self._as_damage():
                is_solid = later["is_solid"]() if marks is None else marks
                array = array_of(cloud, name)
                if not isinstance(is_solid, np.ndarray) or is_solid.dtype != bool or is_solid.shape != array.shape[:1]:
                    raise ValueError(f"invalid marks of {len(array)} points")
                kept: NDArray[Any] = array[is_solid]
                if len(kept) != num_solid:
                    raise ValueError(f"marks of {len(kept)} points that are said to be {num_solid}")
                return kept

        solid = object.__new__(Cloud)
        object.__setattr__(solid, "behind", cloud.behind)
        leave_unread(solid, num_solid, chosen)
        return replace(track, solid=solid)

    @contextmanager
    def _as_damage(self) -> Iterator[None]:
        try:
            yield
        except (ValueError, TypeError) as error:
            raise MapFolderError(f"{self._journal} is damaged or of another version: {error}") from error


def as_array(value: Any, length: int | None) -> NDArray[Any]:
    """Return a decoded array. Raises `ValueError`: it is no array, or of another length."""
    if not isinstance(value, np.ndarray) or (length is not None and value.shape[:1] != (length,)):
        raise ValueError(f"found a {type(value).__name__}, expected an array of length {length}")
    return value
