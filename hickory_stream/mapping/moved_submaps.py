"""Tracks of submaps that a correction has moved against the open one: set apart, and brought back when seen again.

New frames go on in the frame of the odometry, which is that of the open submap. A track of a submap that was placed
elsewhere does not lie there any more: it keeps its data in its own submap, moves with it, and takes no part in the data
association, until an observation matches it where it lies now. Then its data are brought into the open submap's frame,
once, and it is a track like all others. Two tracks that a correction brings together are one object: they are merged.
Both are kept as joins: a later correction that takes them to different places takes them back (`parting`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.events import CancelShape
from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.rigid import apply
from hickory_stream.mapping.associate import associate
from hickory_stream.mapping.far_away import rest_elsewhere
from hickory_stream.mapping.moved_tracks import moved_track, sameness
from hickory_stream.mapping.one_to_one import one_to_one
from hickory_stream.mapping.parting import keep_join, part_joins, past_of
from hickory_stream.mapping.space_agreement import agreed_anew
from hickory_stream.mapping.submaps import placed_at
from hickory_stream.mapping.track import is_object
from hickory_stream.mapping.track_endings import drop, unite
from hickory_stream.mapping.track_table import TrackTable
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from hickory_stream.events import Effect, FrameObserved, PosesCorrected
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.submaps import Submaps
    from hickory_stream.mapping.track import Track

_MIN_SIGHTINGS = 2
_SURE = 1.4
"""Boxes of so much IoU, less 1, are one thing however they came there."""

_CLOSER = 0.1
"""By so much more two tracks must be one than they were before a correction, to be brought together by it."""


def place_submaps(state: MapState, event: PosesCorrected, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Set corrected poses of submaps; part and set apart tracks, and merge what now lies at one place (`merges`)."""
    state.graph = state.graph if event.graph is None else event.graph
    if event.graph is not None and not event.submap_ids:
        return []
    before = state.submaps
    places = dict(zip(event.submap_ids, event.world_from_submap, strict=True))
    state.submaps = agreed_anew(placed_at(before, places), before)
    text = f"submaps {', '.join(map(str, event.submap_ids)) or 'none'} were placed anew"
    state.decide("pose_correction", None, text)
    effects, parted = part_joins(state, config)
    set_apart(state)
    if merges:
        effects += merge_met(state, before, config, parted)
    rest_elsewhere(state)
    return effects


def set_apart(state: MapState) -> None:
    """Put every track to those that lie where the odometry has them, or elsewhere, by the submaps' corrected poses."""
    here: dict[int, Track] = {}
    elsewhere: dict[int, Track] = {}
    for track in state.everywhere():
        (here if state.submaps.is_rigid_with_open(track.submap_id) else elsewhere)[track.id] = track
    if elsewhere.keys() != state.elsewhere.keys():
        state.split_candidates = {i: own for i, own in state.split_candidates.items() if i in here}
    state.tracks, state.elsewhere = TrackTable(here), TrackTable(elsewhere)
    state.stirred = set(here)


def recognise(state: MapState, event: FrameObserved, config: MappingConfig) -> list[Effect]:
    """Bring back the tracks elsewhere that observations of a keyframe match, by the rules of data association."""
    if not state.elsewhere or not event.observations:
        return []
    bounds = [bounds_of(observation.points_world) for observation in event.observations]
    near = {track.id: track for track in _near(state, bounds, config)}
    if not near:
        return []
    state.derived.warm.use(near, state.revision)
    known = TrackTable({track.id: track for one in bounds for track in state.tracks.touching(one)} | near)
    matches = associate(event.observations, known, config.lattice.points_m, config.associate)
    effects: list[Effect] = []
    for track_id in sorted(near.keys() & {match.track_id for match in matches}):
        far, past = state.elsewhere[track_id], past_of(state, track_id)
        effects += _brought_back(state, near[track_id], "a keyframe sees it again")
        keep_join(state, track_id, far, past, None)
    return effects


def merge_met(state: MapState, before: Submaps, config: MappingConfig, parted: Collection[int] = ()) -> list[Effect]:
    """Merge tracks that a correction has brought to the same place; `before` are the submaps as they were placed.

    Pairs are one to one, by the IoU of their boxes first, then by the share of the smaller one's points that lie on the
    other. Two that lay like this before are a thing and what is in it, and stay two; so do those that keyframes have
    seen apart. Those of `parted` lay nowhere before.
    """
    effects: list[Effect] = []
    while met := sorted(_met(state, before, config, parted)):
        for kept_id, gone_id in one_to_one(((a, b) for _, a, b in met), of_one_kind=True):
            effects += _united(state, kept_id, gone_id, config)
    return effects


def _united(state: MapState, kept_id: int, gone_id: int, config: MappingConfig) -> list[Effect]:
    """Merge two tracks of submaps that lie elsewhere to each other, into the frame in which one is seen, if one is."""
    far_id, near_id = (kept_id, gone_id) if gone_id in state.tracks else (gone_id, kept_id)
    far, near, past = state.track(far_id), state.track(near_id), past_of(state, far_id)
    effects: list[Effect] = []
    # Where both lie where the odometry has them, their data are in one frame already.
    if far_id in state.elsewhere and near_id in state.tracks:
        there = _in_open_frame(state, far, config)
        effects += _brought_back(state, there, f"it lies where #{near_id} is")
    elif far_id in state.elsewhere:
        near_from_far = state.submaps.between(near.submap_id, far.submap_id)
        there = moved_track(far, near_from_far, config.lattice.points_m)
        state.elsewhere[far_id] = replace(there, submap_id=near.submap_id)
    effects += unite(state, kept_id, gone_id, "a correction of the poses brought them to one place", config)
    keep_join(state, kept_id, far, past, near)
    return effects


def _met(
    state: MapState, before: Submaps, config: MappingConfig, parted: Collection[int]
) -> Iterator[tuple[float, int, int]]:
    """Yield (-score, lower id, higher id) of tracks of submaps that were moved against each other, now at one place."""
    tracks = [track for track in state.everywhere() if _can_meet(track)]
    if not tracks:
        return
    centers = np.array([apply(state.submaps.world_from(t.submap_id), t.box.center[None])[0] for t in tracks])
    reach = np.array([portable.norm(track.box.half_extents_m) for track in tracks])
    for i, a in enumerate(tracks):
        off = centers[i + 1 :] - centers[i]
        both = reach[i + 1 :] + reach[i]
        near = np.flatnonzero((off * off).sum(axis=1) < both * both)
        for b in (tracks[i + 1 + j] for j in near):
            a_from_b = state.submaps.between(a.submap_id, b.submap_id)
            then = before.between(a.submap_id, b.submap_id)
            is_anew = a.id in parted or b.id in parted
            if (np.array_equal(a_from_b, then) and not is_anew) or state.votes.of(a.id, b.id).apart:
                continue
            score = sameness(a, b, a_from_b, config)
            if score >= _SURE or (score > 0 and (is_anew or score > sameness(a, b, then, config) + _CLOSER)):
                yield -score, a.id, b.id


def end_elsewhere(state: MapState) -> list[Effect]:
    """Drop the tracks elsewhere that are no objects, at the end of the source."""
    effects: list[Effect] = []
    for track in list(state.elsewhere.values()):
        if not is_object(track):
            effects += drop(state, track, "structure" if track.phase is Phase.ROOM else "never confirmed")
    return effects


def _near(state: MapState, bounds: list[NDArray[np.float32]], config: MappingConfig) -> Iterator[Track]:
    """Yield the tracks elsewhere, brought into the open submap's frame, that may touch one of the bounds (2, 3)."""
    low, high = np.array(bounds)[:, 0], np.array(bounds)[:, 1]
    for track_id in sorted(state.elsewhere):
        track = state.elsewhere[track_id]
        center = apply(state.submaps.open_from(track.submap_id), track.box.center[None])[0]
        reach = portable.norm(track.box.half_extents_m)
        if ((low - reach <= center) & (center <= high + reach)).all(axis=1).any():
            yield _in_open_frame(state, track, config)


def _in_open_frame(state: MapState, track: Track, config: MappingConfig) -> Track:
    """Return a track elsewhere as one of the open submap."""
    moved_there = moved_track(track, state.submaps.open_from(track.submap_id), config.lattice.points_m)
    return replace(moved_there, submap_id=state.submaps.open_id, seen_in=state.submaps.open_id)


def _can_meet(track: Track) -> bool:
    return track.phase is not Phase.ROOM and track.sightings >= _MIN_SIGHTINGS


def _brought_back(state: MapState, track: Track, why: str) -> list[Effect]:
    """Put a track, moved into the open submap's frame, to those that lie where the odometry has them."""
    del state.elsewhere[track.id]
    ticket = track.shape_state.open_ticket
    # The answer would be where the track was.
    state.tracks[track.id] = replace(track, shape_state=replace(track.shape_state, open_ticket=None))
    state.decide("pose_correction", track.id, f"recognised in submap {state.submaps.open_id}: {why}")
    return [] if ticket is None else [CancelShape(ticket=ticket)]
