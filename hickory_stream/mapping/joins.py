"""Joins: tracks that a correction of the poses brought together, kept so that a later one can part them again.

Pure functions of joins; `parting` applies them to the map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.mapping.track import Track, without_views

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Iterator, Mapping

    from numpy.typing import NDArray

    from hickory_stream.mapping.track_merging import Votes

_DEEPEST = 3
"""Of joins within joins those further in are final: each holds the clouds of its tracks."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Past:
    """What referred to a track before it was joined to another one.

    `votes` are those of its pairs, by the other one's id, `absorbed` the tracks that it had absorbed, and `joins` those
    of which it was the host.
    """

    votes: dict[int, Votes]
    absorbed: tuple[Track, ...]
    joins: tuple[Join, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Join:
    """A track that was brought into a host from a submap that lies elsewhere.

    `far` is that track as it was, in the frame of its own submap, with its `past`; `at` (3,) is where its box's centre
    came to lie, in the host's frame. `near` is the host without it, `united` the host with it, both right at the join,
    at `stamp_ns`, and in the host's frame; `near` is None where a keyframe recognised the far track, and no other one
    lay there.
    """

    far: Track
    past: Past
    at: NDArray[np.float64]
    near: Track | None
    united: Track
    stamp_ns: int

    def __post_init__(self) -> None:
        freeze(self, "at", np.float64, (3,))

    @property
    def far_ids(self) -> frozenset[int]:
        """The ids of the far track, and of those that had been merged into it."""
        return frozenset({self.far.id, *self.far.merged_ids})


Joins = dict[int, tuple[Join, ...]]
"""The joins of each track by the id of the host, in their order."""


def with_join(joins: Mapping[int, tuple[Join, ...]], host_id: int, join: Join) -> Joins:
    """Return the joins with one more of a host."""
    return {**joins, host_id: (*joins.get(host_id, ()), *_to_depth((join,), _DEEPEST))}


def after_union(joins: Mapping[int, tuple[Join, ...]], kept_id: int, gone_id: int) -> Joins:
    """Return the joins after a track was merged into another one of its frame, which is now the host of all."""
    both = (*joins.get(kept_id, ()), *joins.get(gone_id, ()))
    rest = {host: own for host, own in joins.items() if host not in (kept_id, gone_id)}
    return {**rest, kept_id: both} if both else rest


def without_far(joins: Mapping[int, tuple[Join, ...]], host_id: int, far_id: int) -> Joins:
    """Return the joins without that of a far track, which was split off its host."""
    left = tuple(join for join in joins.get(host_id, ()) if join.far.id != far_id)
    rest = {host: own for host, own in joins.items() if host != host_id}
    return {**rest, host_id: left} if left else rest


def views_in(joins: Iterable[Join]) -> Iterator[str]:
    """Yield the names of the views that tracks need once they are parted."""
    for track, is_parted in _tracks_of(joins):
        if is_parted:
            yield from (view.name for view in track.views)


def joins_without(joins: Mapping[int, tuple[Join, ...]], names: Collection[str]) -> Joins:
    """Return the joins without the views of these names."""
    return {host: tuple(_without_views(join, names) for join in own) for host, own in joins.items()}


def tracks_in(joins: Iterable[Join]) -> Iterator[Track]:
    """Yield the tracks that joins hold, of which some may be the same."""
    for track, _ in _tracks_of(joins):
        yield track


def _tracks_of(joins: Iterable[Join]) -> Iterator[tuple[Track, bool]]:
    """Yield the tracks of joins, and whether a track that is parted needs its views."""
    waiting = list(joins)
    while waiting:
        join = waiting.pop()
        waiting += join.past.joins
        for track in (join.far, *join.past.absorbed, *(() if join.near is None else (join.near,))):
            yield track, True
        yield join.united, False


def _without_views(join: Join, names: Collection[str]) -> Join:
    past = replace(
        join.past,
        absorbed=tuple(without_views(track, names) for track in join.past.absorbed),
        joins=tuple(_without_views(inner, names) for inner in join.past.joins),
    )
    return replace(
        join,
        far=without_views(join.far, names),
        past=past,
        near=None if join.near is None else without_views(join.near, names),
        united=without_views(join.united, names),
    )


def _to_depth(joins: tuple[Join, ...], depth: int) -> tuple[Join, ...]:
    """Return joins without those within them that are further in than so many."""
    if depth == 0:
        return ()
    return tuple(replace(j, past=replace(j.past, joins=_to_depth(j.past.joins, depth - 1))) for j in joins)
