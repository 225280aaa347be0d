"""Tracks of submaps that a correction has moved against the open one: set apart, and brought back when seen again.

New frames go on in the frame of the odometry, which is that of the open submap. A track of a submap that was placed
elsewhere does not lie there any more: it keeps its data in its own submap, moves with it, and takes no part in the data
association, until an observation matches it where it lies now. Then its data are brought into the open submap's frame,
once, and it is a track like all others. Two tracks that a correction brings together are one object: they are merged.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.events import CancelShape
from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.boxes import box_iou, intersection_volume_m3
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import moved
from hickory_stream.mapping.associate import associate
from hickory_stream.mapping.cloud import moved_cloud, share_near
from hickory_stream.mapping.existence import Existence
from hickory_stream.mapping.moved import moved_box, moved_shape, moved_view
from hickory_stream.mapping.one_to_one import one_to_one
from hickory_stream.mapping.submaps import placed_at
from hickory_stream.mapping.track import is_object, with_cloud
from hickory_stream.mapping.track_endings import drop, unite
from hickory_stream.mapping.track_table import TrackTable
from hickory_stream.mapping.views import sector_of
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

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
    """Set corrected poses of submaps; set their tracks apart, and merge what now lies at one place (`merges`)."""
    state.graph = state.graph if event.graph is None else event.graph
    if event.graph is not None and not event.submap_ids:
        return []
    before = state.submaps
    state.submaps = placed_at(state.submaps, dict(zip(event.submap_ids, event.world_from_submap, strict=True)))
    text = f"submaps {', '.join(map(str, event.submap_ids)) or 'none'} were placed anew"
    state.decide("pose_correction", None, text)
    set_apart(state)
    return merge_met(state, before, config) if merges else []


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
    known = TrackTable({track.id: track for one in bounds for track in state.tracks.touching(one)} | near)
    matches = associate(event.observations, known, config.lattice.points_m, config.associate)
    effects: list[Effect] = []
    for track_id in sorted(near.keys() & {match.track_id for match in matches}):
        effects += _brought_back(state, near[track_id], "a keyframe sees it again")
    return effects


def merge_met(state: MapState, before: Submaps, config: MappingConfig) -> list[Effect]:
    """Merge tracks that a correction has brought to the same place; `before` are the submaps as they were placed.

    Pairs are one to one, by the IoU of their boxes first, then by the share of the smaller one's points that lie on the
    other. Two that lay like this before are a thing and what is in it, and stay two; so do those that keyframes have
    seen apart.
    """
    effects: list[Effect] = []
    while met := sorted(_met(state, before, config)):
        for kept_id, gone_id in one_to_one(((a, b) for _, a, b in met), of_one_kind=True):
            effects += _united(state, kept_id, gone_id, config)
    return effects


def _united(state: MapState, kept_id: int, gone_id: int, config: MappingConfig) -> list[Effect]:
    """Merge two tracks of submaps that lie elsewhere to each other."""
    effects: list[Effect] = []
    known = {**state.tracks, **state.elsewhere}
    kept, gone = known[kept_id], known[gone_id]
    # Both into the frame in which one of them is seen, if one is.
    if gone_id in state.tracks:
        effects += _brought_back(state, _in_open_frame(state, kept, config), f"it lies where #{gone_id} is")
    elif kept_id in state.tracks:
        effects += _brought_back(state, _in_open_frame(state, gone, config), f"it lies where #{kept_id} is")
    else:
        kept_from_gone = state.submaps.between(kept.submap_id, gone.submap_id)
        there = moved_track(gone, kept_from_gone, config.lattice.points_m)
        state.elsewhere[gone_id] = replace(there, submap_id=kept.submap_id)
    effects += unite(state, kept_id, gone_id, "a correction of the poses brought them to one place", config)
    return effects


def _met(state: MapState, before: Submaps, config: MappingConfig) -> Iterator[tuple[float, int, int]]:
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
            if np.array_equal(a_from_b, then) or state.votes.of(a.id, b.id).apart:
                continue
            score = _sameness(a, b, a_from_b, config)
            if score >= _SURE or (score > 0 and score > _sameness(a, b, then, config) + _CLOSER):
                yield -score, a.id, b.id


def end_elsewhere(state: MapState) -> list[Effect]:
    """Drop the tracks elsewhere that are no objects, at the end of the source."""
    effects: list[Effect] = []
    for track in list(state.elsewhere.values()):
        if not is_object(track):
            effects += drop(state, track, "structure" if track.phase is Phase.ROOM else "never confirmed")
    return effects


def moved_track(track: Track, new_from_old: NDArray[np.float64], voxel_m: float) -> Track:
    """Return a track in another frame, its cloud on the lattice there; `new_from_old` (4, 4) is rigid."""
    views = {view.name: moved_view(view, new_from_old) for view in track.views}
    known = track.existence
    there = replace(
        with_cloud(track, moved_cloud(track.cloud, new_from_old, voxel_m), track.sightings, voxel_m),
        best_view=None if track.best_view is None else views[track.best_view.name],
        shape=None if track.shape is None else moved_shape(track.shape, new_from_old),
        sketch=None if track.sketch is None else moved(track.sketch, new_from_old),
        existence=Existence(evidence=known.evidence, places=apply(new_from_old, known.places)),
    )
    kept = [views[view.name] for _, view in track.coverage]
    sectors = {sector_of(view, there.box.center): view for view in kept}
    return replace(there, coverage=tuple(sorted(sectors.items())))


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


def _sameness(a: Track, b: Track, a_from_b: NDArray[np.float64], config: MappingConfig) -> float:
    """Return how surely two tracks at one place are the same object: 1 to 2 by boxes, up to 1 by points, 0 not."""
    associate_config = config.associate
    there = moved_box(b.box, a_from_b)
    iou = box_iou(a.box, there)
    if iou >= associate_config.min_iou:
        return 1.0 + iou
    a_is_small = a.box.volume_m3 < b.box.volume_m3
    least = min(a.box.volume_m3, b.box.volume_m3)
    if intersection_volume_m3(a.box, there) < associate_config.min_lies_on * least:
        return 0.0
    own = moved_cloud(b.solid, a_from_b, config.lattice.points_m)
    share = share_near(a.solid.keys, own) if a_is_small else share_near(own.keys, a.cloud)
    return share if share >= associate_config.min_lies_on else 0.0


def _brought_back(state: MapState, track: Track, why: str) -> list[Effect]:
    """Put a track, moved into the open submap's frame, to those that lie where the odometry has them."""
    del state.elsewhere[track.id]
    ticket = track.shape_state.open_ticket
    # The answer would be where the track was.
    state.tracks[track.id] = replace(track, shape_state=replace(track.shape_state, open_ticket=None))
    state.decide("pose_correction", track.id, f"recognised in submap {state.submaps.open_id}: {why}")
    return [] if ticket is None else [CancelShape(ticket=ticket)]
