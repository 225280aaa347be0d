"""Merged tracks, kept so that a later split or correction of the poses can restore them.

`Absorbed` tracks were merged by keyframes: a split restores their history. `Join`s were made by a correction of the
poses: another one can take them back.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.mapping.entities.cloud import Cloud, share_near
from hickory_stream.mapping.entities.track import Track, without_views
from hickory_stream.mapping.rules.merging import Votes
from hickory_stream.records import Phase

# Joins deeper within joins are final: each holds the clouds of its tracks.
_DEEPEST = 3


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Past:
    """The references to a track before a join: its votes by the other id, the tracks it had absorbed, and its joins."""

    votes: dict[int, Votes]
    absorbed: tuple[Track, ...]
    joins: "tuple[Join, ...]"


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Join:
    """A track that was brought into a host from a submap that lies elsewhere."""

    #: that track as it was, in the frame of its own submap
    far: Track
    past: Past
    #: the centre (3,) of its box at the join, in the host's frame
    at: NDArray[np.float64]
    #: the host without it; None if a keyframe recognised the far track and none lay there
    near: Track | None
    #: the host with it, right at the join
    united: Track
    stamp_ns: int

    def __post_init__(self) -> None:
        freeze(self, "at", np.float64, (3,))

    @property
    def far_ids(self) -> frozenset[int]:
        """The ids of the far track, and of all tracks merged into it."""
        return frozenset({self.far.id, *self.far.merged_ids})


# By the id of the host, in their order.
Joins = dict[int, tuple[Join, ...]]


def with_join(joins: Mapping[int, tuple[Join, ...]], host_id: int, join: Join) -> Joins:
    """Return the joins with one more of a host."""
    return {**joins, host_id: (*joins.get(host_id, ()), *_to_depth((join,), _DEEPEST))}


def after_union(joins: Mapping[int, tuple[Join, ...]], kept_id: int, gone_id: int) -> Joins:
    """Return the joins after a merge of two tracks of one frame: the kept one is the host of all."""
    both = (*joins.get(kept_id, ()), *joins.get(gone_id, ()))
    rest = {host: own for host, own in joins.items() if host not in (kept_id, gone_id)}
    return {**rest, kept_id: both} if both else rest


def without_far(joins: Mapping[int, tuple[Join, ...]], host_id: int, far_id: int) -> Joins:
    """Return the joins without one far track, which was split off its host."""
    left = tuple(join for join in joins.get(host_id, ()) if join.far.id != far_id)
    rest = {host: own for host, own in joins.items() if host != host_id}
    return {**rest, host_id: left} if left else rest


def views_in(joins: Iterable[Join]) -> Iterator[str]:
    """Yield the names of the views that tracks need once their joins are taken back."""
    return (view.name for track, needs_views in _tracks_of(joins) if needs_views for view in track.views)


def joins_without(joins: Mapping[int, tuple[Join, ...]], names: Collection[str]) -> Joins:
    """Return the joins without the views of these names."""
    return {host: tuple(_without_views(join, names) for join in own) for host, own in joins.items()}


def tracks_in(joins: Iterable[Join]) -> Iterator[Track]:
    """Yield the tracks that joins hold; some may be the same."""
    return (track for track, _ in _tracks_of(joins))


def _tracks_of(joins: Iterable[Join]) -> Iterator[tuple[Track, bool]]:
    # True: an unmerge of this track needs its views.
    waiting = list(joins)
    while waiting:
        join = waiting.pop()
        waiting += join.past.joins
        yield from ((track, True) for track in (join.far, *join.past.absorbed, join.near) if track is not None)
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
    if depth == 0:
        return ()
    return tuple(replace(j, past=replace(j.past, joins=_to_depth(j.past.joins, depth - 1))) for j in joins)


# The confirmed tracks that each host has absorbed, by its id.
Absorbed = dict[int, tuple["Track", ...]]


def after_merge(absorbed: Mapping[int, tuple[Track, ...]], kept_id: int, gone: Track) -> Absorbed:
    """Return the absorbed tracks after `gone` was merged into `kept_id`, with those that `gone` had absorbed."""
    updated = {host: tracks for host, tracks in absorbed.items() if host != gone.id}
    own = () if gone.phase is Phase.TENTATIVE else (gone,)
    if taken := (*absorbed.get(kept_id, ()), *absorbed.get(gone.id, ()), *own):
        updated[kept_id] = taken
    return updated


def recalled(absorbed: Mapping[int, tuple[Track, ...]], host_id: int, cloud: Cloud, same_share: float) -> Track | None:
    """Return the host's absorbed track that best matches a split-off cloud, or None."""
    # Two clouds match if at least `same_share` of each lies on the other.
    best, most = None, same_share
    for track in absorbed.get(host_id, ()):
        share = min(share_near(cloud.keys, track.solid), share_near(track.solid.keys, cloud))
        if share >= most:
            best, most = track, share
    return best


def restored(new: Track, before: Track) -> Track:
    """Return a split-off track with its history from before the merge: times, viewpoints and views."""
    return replace(
        new,
        sightings=max(new.sightings, before.sightings),
        first_seen_ns=min(new.first_seen_ns, before.first_seen_ns),
        observed_ns=max(new.observed_ns, before.observed_ns),
        coverage=tuple((sector, replace(view, object_id=new.id)) for sector, view in before.coverage),
        best_view=None if before.best_view is None else replace(before.best_view, object_id=new.id),
    )


def without_views_of(host: Track, before: Track) -> Track:
    """Return a host without the views of a track that was split off, unless it has no other views."""
    left = without_views(host, {view.name for view in before.views})
    return left if left.views else host


def after_split(absorbed: Mapping[int, tuple[Track, ...]], host_id: int, before: Track) -> Absorbed:
    """Return the absorbed tracks after `before` was split off its host again."""
    rest = tuple(track for track in absorbed.get(host_id, ()) if track is not before)
    updated = {host: tracks for host, tracks in absorbed.items() if host != host_id}
    return {**updated, host_id: rest} if rest else updated


def after_unmerge(
    absorbed: Mapping[int, tuple[Track, ...]], host_id: int, far_ids: Collection[int], rest_id: int | None
) -> Absorbed:
    """Return the absorbed tracks after a join was taken back: `rest_id` is the host without `far_ids`."""
    left = tuple(t for t in absorbed.get(host_id, ()) if t.id not in far_ids and t.id != rest_id)
    updated = {host: tracks for host, tracks in absorbed.items() if host != host_id}
    return {**updated, rest_id: left} if left and rest_id is not None else updated


def without_lost_views(absorbed: Mapping[int, tuple[Track, ...]], names: Collection[str]) -> Absorbed:
    """Return the absorbed tracks without the views of these names."""
    return {host: tuple(without_views(track, names) for track in tracks) for host, tracks in absorbed.items()}
