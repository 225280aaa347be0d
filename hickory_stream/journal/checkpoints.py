"""The state of the core in a checkpoint: the reliable part of a track's cloud is a mask over its points."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze, frozen_array
from hickory_stream.mapping.entities.cloud import NAMES, Cloud, without
from hickory_stream.mapping.entities.observed_space import SpaceState
from hickory_stream.mapping.entities.submap_surface import SubmapSurface
from hickory_stream.mapping.entities.submaps import SubmapState
from hickory_stream.mapping.entities.track import Track
from hickory_stream.mapping.rules.merging import VoteBook
from hickory_stream.mapping.rules.splitting import SplitCandidate
from hickory_stream.records import Submap, SurveyedSubmap, TrackedObject


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PackedTrack:
    """A track whose `solid` is a mask over its cloud, which halves a checkpoint."""

    track: Track
    is_solid: NDArray[np.bool_]
    num_solid: int

    def __post_init__(self) -> None:
        freeze(self, "is_solid", "?", (len(self.track.cloud.keys),))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TablePage:
    """A part of a table by ids, one block of ids: most pages are equal in consecutive states."""

    keys: tuple[int, ...]
    values: tuple[Any, ...]


_PAGE = 32
_TABLES = {"tracks", "elsewhere", "absorbed", "split_candidates"}
KEPT_RECORDS = (
    *(PackedTrack, SplitCandidate, SpaceState, Submap, SubmapState, SubmapSurface, SurveyedSubmap, TablePage),
    *(Track, TrackedObject),
)
"""Records that a checkpoint shares with the one before: there are many, few change."""


class Packer:
    """Packs states; an unchanged track gives the identical packed track, so that it is written once.

    `stored`: packed tracks that are written already.
    """

    def __init__(self, stored: Iterable[Track] = ()) -> None:
        self._marks: dict[int, _Marks] = {}
        self._packed: dict[int, tuple[Track, Track | PackedTrack]] = {id(track): (track, track) for track in stored}
        self._pages: dict[tuple[str, int], tuple[list[int], list[Any], TablePage]] = {}

    def packed(self, state: Mapping[str, Any]) -> dict[str, Any]:
        """Return a state of the core with its tracks packed where that loses nothing."""
        marks, self._marks = self._marks, {}
        before, self._packed = self._packed, {}

        def pack(track: Track) -> Track | PackedTrack:
            known = before.get(id(track))
            own = marks.get(id(track.solid))
            if own is not None and own.cloud is track.cloud:
                self._marks[id(track.solid)] = own
            if known is None:
                if own is None or own.cloud is not track.cloud:
                    own = _Marks(cloud=track.cloud, solid=track.solid, is_solid=_solid_marks(track.cloud, track.solid))
                    self._marks[id(track.solid)] = own
                known = (track, track)
                if own.is_solid is not None:
                    whole = replace(track, solid=track.cloud)
                    known = (track, PackedTrack(track=whole, is_solid=own.is_solid, num_solid=len(track.solid)))
            self._packed[id(track)] = known
            return known[1]

        pages, self._pages = self._pages, {}

        def paged(name: str, table: Mapping[int, Any]) -> tuple[TablePage, ...]:
            blocks: dict[int, list[int]] = {}
            for key in sorted(table):
                blocks.setdefault(key // _PAGE, []).append(key)
            return tuple(page(name, block, keys, table) for block, keys in blocks.items())

        def page(name: str, block: int, keys: list[int], table: Mapping[int, Any]) -> TablePage:
            values = [table[key] for key in keys]
            known = pages.get((name, block))
            if known is None or known[0] != keys or any(a is not b for a, b in zip(known[1], values, strict=True)):
                own = tuple(pack(value) if isinstance(value, Track) else value for value in values)
                known = (keys, values, TablePage(keys=tuple(keys), values=own))
            else:
                for value in values:
                    if isinstance(value, Track):
                        pack(value)
            self._pages[name, block] = known
            return known[2]

        parts = dict(state)
        for name in _TABLES & parts.keys():
            parts[name] = paged(name, parts[name])
        if isinstance(votes := parts.get("votes"), VoteBook):
            parts["votes"] = paged("votes", votes.rows)
        return parts


def unpacked(state: Mapping[str, Any]) -> dict[str, Any]:
    """Return the unpacked state. Raises `ValueError`: numbers of keys and values of a page differ."""
    parts = dict(state) | {name: _table(state[name]) for name in _TABLES & state.keys()}
    if isinstance(parts.get("votes"), tuple):
        parts["votes"] = VoteBook(rows=_table(parts["votes"]))
    return parts


def _table(pages: tuple[TablePage, ...]) -> dict[int, Any]:
    return {key: _unpacked(value) for page in pages for key, value in zip(page.keys, page.values, strict=True)}


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Marks:
    # Both clouds are held, so that their identities stay unique. `is_solid` None: all, none, or more than a choice of
    # the points.
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


def _unpacked(value: Any) -> Any:
    if not isinstance(value, PackedTrack):
        return value
    return replace(value.track, solid=without(value.track.cloud, ~value.is_solid))


def _is_same(a: Cloud, b: Cloud) -> bool:
    pairs = [(getattr(a, name), getattr(b, name)) for name in NAMES]
    is_same = all(x.dtype == y.dtype and x.shape == y.shape and x.tobytes() == y.tobytes() for x, y in pairs)
    return is_same and a.behind == b.behind
