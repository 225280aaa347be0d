"""Which tracks a keyframe concerns: those whose judgement it can have changed.

A track is judged by itself, by the observed space and the tracks around it, and by how long it was not seen. So of the
tracks out of sight only those are judged again that have changed, that lie beside one that has, or whose time is up:
for all others the judgement would be the one of the keyframe before. Only the height of the floor, which is filtered
over keyframes, reaches them when they are seen again.
"""

from __future__ import annotations

import heapq
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.voxels import layers_of_keys
from hickory_stream.mapping.observed_space import window_of
from hickory_stream.mapping.structure_checks import RESTING_S
from hickory_stream.mapping.track_table import REACH_M

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from hickory_stream.events import FrameObserved
    from hickory_stream.mapping.lifecycle import LifecycleConfig
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.track import Track
    from hickory_stream.mapping.track_table import Mark

_ROUNDING_NS = 2


class Concerned:
    """The ids of the tracks to judge at a keyframe, ascending; those that judgements bring up are added on the way.

    What has changed by then, and what lies beside it, concerns the next keyframe as well (`state.stirred`).
    """

    def __init__(self, state: MapState, event: FrameObserved, config: LifecycleConfig) -> None:
        self._state = state
        self._stirred: set[int] = set()
        sight = _sight_of(event, state.submaps.space.voxel_m)
        ids = {*state.stirred, *_timed_out(state, config)}
        # What was seen in the keyframe before has become known since its tracks were judged.
        for bounds in (sight, state.sight):
            if bounds is not None:
                ids |= {track.id for track in state.tracks.touching(bounds, REACH_M)}
        self._waiting = sorted(ids)
        self._named = ids
        state.sight, state.judged_ns, state.stirred = sight, state.clock_ns, self._stirred

    def __iter__(self) -> Iterator[int]:
        while self._waiting:
            track_id = heapq.heappop(self._waiting)
            if track_id in self._state.tracks:
                before, mark = self._state.tracks[track_id], self._state.tracks.now
                yield track_id
                self._stir(track_id, before, mark)

    def _stir(self, track_id: int, before: Track, mark: Mark) -> None:
        tracks = self._state.tracks
        for changed in tracks.changed_since(mark):
            beside = [before] if changed == track_id else []
            beside += [tracks[changed]] if changed in tracks else []
            for one in beside:
                self._add(track_id, (other.id for other in tracks.touching(one.bounds, REACH_M)))

    def _add(self, track_id: int, ids: Iterable[int]) -> None:
        for other in ids:
            self._stirred.add(other)
            if other > track_id and other not in self._named:
                self._named.add(other)
                heapq.heappush(self._waiting, other)


def _timed_out(state: MapState, config: LifecycleConfig) -> Iterator[int]:
    """Yield the tracks that were not seen for one of the times that count, since the last keyframe's judgement."""
    for limit_s in (RESTING_S, config.tentative_s, config.dormant_s, config.archive_s):
        limit_ns = int(limit_s * 1e9)
        after_ns, until_ns = state.judged_ns - limit_ns - _ROUNDING_NS, state.clock_ns - limit_ns + _ROUNDING_NS
        yield from state.tracks.last_seen(after_ns, until_ns)


def _sight_of(event: FrameObserved, voxel_m: float) -> NDArray[np.float32] | None:
    """Return (2, 3) the least and greatest coordinates of what a keyframe sees, None if it sees nothing."""
    space = event.space
    keys = (space.free_keys, space.structure_keys, space.surface_keys)
    window = window_of(*keys)
    bounds = []
    if window is not None:
        heights = np.concatenate([[layers.min(), layers.max()] for layers in map(layers_of_keys, keys) if len(layers)])
        low, high = (*window.low, heights.min()), (*window.high, heights.max() + 1)
        bounds.append(np.array([low, high], dtype=np.float64) * voxel_m)
    for observation in event.observations:
        corners = observation.box.corners_world()
        bounds.append(np.stack([corners.min(axis=0), corners.max(axis=0)]))
    if not bounds:
        return None
    both = np.array(bounds)
    return np.stack([both[:, 0].min(axis=0), both[:, 1].max(axis=0)]).astype(np.float32)
