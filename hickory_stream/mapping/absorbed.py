"""Absorbed tracks: those that were merged into another track, kept so that a later split can restore their history.

A merge may be wrong, and later keyframes may segment the two objects apart again. The history of an absorbed track
(when and from where it was seen, its views) is kept for as long as the track that absorbed it exists.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hickory_stream.mapping.cloud import share_near
from hickory_stream.mapping.existence import united
from hickory_stream.mapping.track import without_views
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping

    from hickory_stream.mapping.cloud import Cloud
    from hickory_stream.mapping.track import Track

Absorbed = dict[int, tuple["Track", ...]]
"""The confirmed tracks that each track has absorbed, by the id of the absorbing track (the host)."""


def after_merge(absorbed: Mapping[int, tuple[Track, ...]], kept_id: int, gone: Track) -> Absorbed:
    """Return the absorbed tracks after `gone` was merged into `kept_id`, which inherits those absorbed by `gone`."""
    updated = {host: tracks for host, tracks in absorbed.items() if host != gone.id}
    own = () if gone.phase is Phase.TENTATIVE else (gone,)
    if taken := (*absorbed.get(kept_id, ()), *absorbed.get(gone.id, ()), *own):
        updated[kept_id] = taken
    return updated


def recalled(absorbed: Mapping[int, tuple[Track, ...]], host_id: int, cloud: Cloud, same_share: float) -> Track | None:
    """Return the absorbed track that a cloud split off a host matches; None if it matches none of the host's.

    Two clouds match if at least `same_share` of each lies on the other; of several matches, the best is returned.
    """
    best, most = None, same_share
    for track in absorbed.get(host_id, ()):
        share = min(share_near(cloud.keys, track.solid), share_near(track.solid.keys, cloud))
        if share >= most:
            best, most = track, share
    return best


def restored(new: Track, before: Track) -> Track:
    """Return a split-off track with the history that it had before the merge: times, viewpoints and views."""
    return replace(
        new,
        sightings=max(new.sightings, before.sightings),
        first_seen_ns=min(new.first_seen_ns, before.first_seen_ns),
        existence=united(new.existence, before.existence),
        coverage=tuple((sector, replace(view, object_id=new.id)) for sector, view in before.coverage),
        best_view=None if before.best_view is None else replace(before.best_view, object_id=new.id),
    )


def without_views_of(host: Track, before: Track) -> Track:
    """Return a host without the views inherited from a track that was split off again, unless it has no other views."""
    left = without_views(host, {view.name for view in before.views})
    return left if left.views else host


def after_split(absorbed: Mapping[int, tuple[Track, ...]], host_id: int, before: Track) -> Absorbed:
    """Return the absorbed tracks after `before` was split off its host again."""
    rest = tuple(track for track in absorbed.get(host_id, ()) if track is not before)
    updated = {host: tracks for host, tracks in absorbed.items() if host != host_id}
    return {**updated, host_id: rest} if rest else updated


def after_parting(
    absorbed: Mapping[int, tuple[Track, ...]], host_id: int, far_ids: Collection[int], rest_id: int | None
) -> Absorbed:
    """Return the absorbed tracks after a join was parted: `rest_id` is the host without those of `far_ids`."""
    left = tuple(t for t in absorbed.get(host_id, ()) if t.id not in far_ids and t.id != rest_id)
    updated = {host: tracks for host, tracks in absorbed.items() if host != host_id}
    return {**updated, rest_id: left} if left and rest_id is not None else updated


def without_lost_views(absorbed: Mapping[int, tuple[Track, ...]], names: Collection[str]) -> Absorbed:
    """Return the absorbed tracks without the views of these names."""
    return {host: tuple(without_views(track, names) for track in tracks) for host, tracks in absorbed.items()}


def views_of(absorbed: Mapping[int, tuple[Track, ...]]) -> Iterator[str]:
    """Yield the names of the views that the absorbed tracks need."""
    return (view.name for tracks in absorbed.values() for track in tracks for view in track.views)
