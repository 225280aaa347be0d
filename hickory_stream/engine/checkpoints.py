"""The state of the core as a checkpoint keeps it: the sure part of a track's cloud is but a choice of its points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.mapping.cloud import Cloud, without
from hickory_stream.mapping.track import Track

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PackedTrack:
    """A track whose `solid` is the part of its cloud that is marked: half of what a checkpoint would take."""

    track: Track
    is_solid: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self, "is_solid", "?", (len(self.track.cloud.keys),))


def packed(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return a state of the core with its tracks packed, where that loses nothing."""
    return {name: _each(value, Track, _packed) for name, value in state.items()}


def unpacked(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state that was packed."""
    return {name: _each(value, PackedTrack, _unpacked) for name, value in state.items()}


def _each(value: Any, kind: type, change: Any) -> Any:
    if isinstance(value, dict) and any(isinstance(item, kind) for item in value.values()):
        return {key: change(item) if isinstance(item, kind) else item for key, item in value.items()}
    return value


def _packed(track: Track) -> Track | PackedTrack:
    if track.solid is track.cloud:
        return track
    marked = np.isin(track.cloud.keys, track.solid.keys, assume_unique=True)
    if not _is_same(without(track.cloud, ~marked), track.solid):
        return track
    return PackedTrack(track=replace(track, solid=track.cloud), is_solid=marked)


def _unpacked(packed_track: PackedTrack) -> Track:
    track = packed_track.track
    return replace(track, solid=without(track.cloud, ~packed_track.is_solid))


def _is_same(a: Cloud, b: Cloud) -> bool:
    pairs = ((a.keys, b.keys), (a.points, b.points), (a.colors, b.colors), (a.hits, b.hits))
    return all(x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes() for x, y in pairs)
