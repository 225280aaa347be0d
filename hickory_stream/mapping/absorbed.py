"""Tracks that were merged into others: a split that shows one of them again gives it its history back.

A merge may be wrong, and later keyframes may tell the two apart. What was known of the one that went, since when it was
seen and from where, is kept as long as the track that took it in.
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
"""The confirmed tracks that each track took in, by its id."""


def after_merge(absorbed: Mapping[int, tuple[Track, ...]], kept_id: int, gone: Track) -> Absorbed:
    """Return what is absorbed after a track was merged into another, which takes over what that one had taken in."""
    updated = {host: tracks for host, tracks in absorbed.items() if host != gone.id}
    own = () if gone.phase is Phase.TENTATIVE else (gone,)
    if taken := (*absorbed.get(kept_id, ()), *absorbed.get(gone.id, ()), *own):
        updated[kept_id] = taken
    return updated


def recalled(absorbed: Mapping[int, tuple[Track, ...]], host_id: int, cloud: Cloud, same_share: float) -> Track | None:
    """Return the track that a cloud is again, split off a host; None if it is none of those that the host took in.

    Of both clouds `same_share` lies on the other; of several the one with the most in common.
    """
    best, most = None, same_share
    for track in absorbed.get(host_id, ()):
        share = min(share_near(cloud.keys, track.solid), share_near(track.solid.keys, cloud))
        if share >= most:
            best, most = track, share
    return best


def restored(new: Track, before: Track) -> Track:
    """Return a track that was split off with the history that it had before it was merged: times, places and views."""
    return replace(
        new,
        sightings=max(new.sightings, before.sightings),
        first_seen_ns=min(new.first_seen_ns, before.first_seen_ns),
        existence=united(new.existence, before.existence),
        coverage=tuple((sector, replace(view, object_id=new.id)) for sector, view in before.coverage),
        best_view=None if before.best_view is None else replace(before.best_view, object_id=new.id),
    )


def without_views_of(host: Track, before: Track) -> Track:
    """Return a host without the views that it had from a track that was split off again, if any of its own are left."""
    left = without_views(host, {view.name for view in before.views})
    return left if left.views else host


def after_split(absorbed: Mapping[int, tuple[Track, ...]], host_id: int, before: Track) -> Absorbed:
    """Return what is absorbed after a track was split off its host again."""
    rest = tuple(track for track in absorbed.get(host_id, ()) if track is not before)
    updated = {host: tracks for host, tracks in absorbed.items() if host != host_id}
    return {**updated, host_id: rest} if rest else updated


def without_lost_views(absorbed: Mapping[int, tuple[Track, ...]], names: Collection[str]) -> Absorbed:
    """Return what is absorbed without some of its views."""
    return {host: tuple(without_views(track, names) for track in tracks) for host, tracks in absorbed.items()}


def views_of(absorbed: Mapping[int, tuple[Track, ...]]) -> Iterator[str]:
    """Yield the names of the views that the absorbed tracks need."""
    return (view.name for tracks in absorbed.values() for track in tracks for view in track.views)
