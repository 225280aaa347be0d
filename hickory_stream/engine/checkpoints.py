"""The state of the core as a checkpoint stores it: the reliable part of a track's cloud as a mask over its points."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.geometry.arrays import freeze, frozen_array
from hickory_stream.mapping.cloud import Cloud, without
from hickory_stream.mapping.track import Track

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PackedTrack:
    """A track whose `solid` is stored as a mask over its cloud: half of what a checkpoint would take."""

    track: Track
    is_solid: NDArray[np.bool_]

    def __post_init__(self) -> None:
        freeze(self, "is_solid", "?", (len(self.track.cloud.keys),))


class Packer:
    """Packs states one after another; of a track that did not change the same marks are given again.

    So that who writes arrays by their identity writes these once.
    """

    def __init__(self) -> None:
        self._marks: dict[int, _Marks] = {}

    def packed(self, state: Mapping[str, Any]) -> dict[str, Any]:
        """Return a state of the core with its tracks packed, where that loses nothing."""
        before, self._marks = self._marks, {}

        def pack(track: Track) -> Track | PackedTrack:
            marks = before.get(id(track.solid))
            if marks is None or marks.cloud is not track.cloud:
                marks = _Marks(cloud=track.cloud, solid=track.solid, is_solid=_solid_marks(track.cloud, track.solid))
            self._marks[id(track.solid)] = marks
            if marks.is_solid is None:
                return track
            return PackedTrack(track=replace(track, solid=track.cloud), is_solid=marks.is_solid)

        return {name: _each(value, Track, pack) for name, value in state.items()}


def unpacked(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the state that was packed."""
    return {name: _each(value, PackedTrack, _unpacked) for name, value in state.items()}


def _each(value: Any, kind: type, change: Any) -> Any:
    if isinstance(value, dict) and any(isinstance(item, kind) for item in value.values()):
        return {key: change(item) if isinstance(item, kind) else item for key, item in value.items()}
    return value


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Marks:
    """Which of a cloud's points are its solid part; None where that is the whole, none, or more than a choice of them.

    It holds both clouds, whose identities then are nobody else's.
    """

    cloud: Cloud
    solid: Cloud
    is_solid: NDArray[np.bool_] | None


def _solid_marks(cloud: Cloud, solid: Cloud) -> NDArray[np.bool_] | None:
    if solid is cloud or len(solid.keys) == 0:
        return None
    # Keys are sorted.
    places = np.minimum(np.searchsorted(solid.keys, cloud.keys), len(solid.keys) - 1)
    marked = solid.keys[places] == cloud.keys
    return frozen_array(marked, "?", (None,), "marks") if _is_same(without(cloud, ~marked), solid) else None


def _unpacked(packed_track: PackedTrack) -> Track:
    track = packed_track.track
    return replace(track, solid=without(track.cloud, ~packed_track.is_solid))


def _is_same(a: Cloud, b: Cloud) -> bool:
    pairs = ((a.keys, b.keys), (a.points, b.points), (a.colors, b.colors), (a.hits, b.hits))
    return all(x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes() for x, y in pairs)
