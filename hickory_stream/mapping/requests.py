"""Which shapes to ask for: new objects first, then those that would gain most, a few at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.mapping.track import Track

# Of eight around an object's middle, as many must show what it stands on.
_SUPPORT_SECTORS = 4


@dataclass(frozen=True, kw_only=True, slots=True)
class RequestConfig:
    """The budget of shape jobs.

    Attributes:
        max_in_flight: jobs that are open at a time.
        latency_s: a result is committed at the first keyframe this long after its request (playback).
        first_sightings: an object's first shape is asked for after so many sightings, or as soon as it is out of view:
            what is still being looked at will be known better in a moment.
        min_gain: a shape is renewed when new views and new surface add up to this much.
        final_gain: the same when the source has ended.
        interval_s: not sooner after the last request for the same object.
        max_failures: after so many failures the object is set aside.
    """

    max_in_flight: int = 4
    latency_s: float = 4.0
    first_sightings: int = 20
    min_gain: float = 1.2
    final_gain: float = 0.5
    interval_s: float = 8.0
    max_failures: int = 2


def next_requests(
    tracks: Mapping[int, Track], num_open: int, clock_ns: int, *, is_final: bool, config: RequestConfig
) -> list[int]:
    """Return the ids of the objects to ask shapes for now, most urgent first; all of them when the source ended."""
    urgency = [
        (-gain, track.id)
        for track in tracks.values()
        if (gain := _urgency(track, clock_ns, is_final=is_final, config=config)) is not None
    ]
    free = len(urgency) if is_final else max(0, config.max_in_flight - num_open)
    return [track_id for _, track_id in sorted(urgency)[:free]]


def gain_of(track: Track) -> float:
    """Return what a new shape would know more: the share of new views and of new surface; 10 for a first one."""
    state = track.shape_state
    if track.shape is None and not state.asked_views:
        return 10.0
    names = {view.name for view in track.views}
    new_views = len(names - set(state.asked_views)) / max(len(names), 1)
    growth = len(track.solid.keys) / max(state.asked_points, 1) - 1.0
    return new_views + min(max(growth, 0.0), 1.0)


def support_height_m(track: Track, others: Iterable[Track], floor_z_m: float | None) -> float | None:
    """Return the height of what an object stands on: another object's top, or the floor; None if unknown."""
    bottom = float(track.box.center[2] - track.box.half_extents_m[2])
    best: float | None = None
    for other in others:
        if other.id == track.id or other.box.center[2] - other.box.half_extents_m[2] > bottom - 0.01:
            continue
        points = other.cloud.points
        near = points[(points[:, 2] > bottom - 0.10) & (points[:, 2] < bottom + 0.03)]
        under = near[track.box.is_over_or_under(near, 0.03)]
        if len(under) >= 10 and _surrounds(under, track.box):
            height = float(np.quantile(under[:, 2], 0.8))
            best = height if best is None else max(best, height)
    if best is not None:
        return best
    return floor_z_m if floor_z_m is not None and bottom - floor_z_m < 0.35 else None


def _surrounds(points: NDArray[np.float32], box: OrientedBox) -> bool:
    """Return whether points lie on most sides of a box's middle: a neighbour beside it is no support."""
    x, y = (points[:, :2] - box.center[:2]).T
    sectors = np.floor((np.arctan2(y, x) + np.pi) / (2 * np.pi) * 8).astype(np.int64) % 8
    return int((np.bincount(sectors, minlength=8) > 0).sum()) >= _SUPPORT_SECTORS


def _urgency(track: Track, clock_ns: int, *, is_final: bool, config: RequestConfig) -> float | None:
    state = track.shape_state
    if track.phase is Phase.TENTATIVE or not track.views or state.open_ticket is not None:
        return None
    if state.failures >= config.max_failures:
        return None
    gain = gain_of(track)
    if is_final:
        return gain if track.shape is None or gain >= config.final_gain else None
    if state.asked_views and (clock_ns - state.asked_clock_ns) / 1e9 < config.interval_s:
        return None
    is_in_view = track.phase is Phase.ACTIVE
    if track.shape is None and is_in_view and track.sightings < config.first_sightings:
        return None
    return gain if gain >= config.min_gain else None
