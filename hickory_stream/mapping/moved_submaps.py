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
from hickory_stream.geometry.rigid import apply, compose
from hickory_stream.geometry.superquadric import moved
from hickory_stream.mapping.associate import associate
from hickory_stream.mapping.cloud import moved_cloud, share_near
from hickory_stream.mapping.existence import Existence
from hickory_stream.mapping.moved import moved_shape
from hickory_stream.mapping.submaps import placed_at
from hickory_stream.mapping.track import is_object, touching, with_cloud
from hickory_stream.mapping.track_endings import drop, unite
from hickory_stream.mapping.views import sector_of
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from hickory_stream.events import Effect, FrameObserved, PosesCorrected
    from hickory_stream.mapping.associate import AssociateConfig
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.track import Track
    from hickory_stream.records import View

_MIN_SIGHTINGS = 2


def place_submaps(state: MapState, event: PosesCorrected, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Set corrected poses of submaps; set their tracks apart, and merge what now lies at one place (`merges`)."""
    state.graph = state.graph if event.graph is None else event.graph
    if event.graph is not None and not event.submap_ids:
        return []
    state.submaps = placed_at(state.submaps, dict(zip(event.submap_ids, event.world_from_submap, strict=True)))
    text = f"submaps {', '.join(map(str, event.submap_ids)) or 'none'} were placed anew"
    state.decide("pose_correction", None, text)
    set_apart(state)
    return merge_met(state, config) if merges else []


def set_apart(state: MapState) -> None:
    """Put every track to those that lie where the odometry has them, or elsewhere, by the submaps' corrected poses."""
    here: dict[int, Track] = {}
    elsewhere: dict[int, Track] = {}
    for track in state.everywhere():
        (here if state.submaps.is_rigid_with_open(track.submap_id) else elsewhere)[track.id] = track
    if elsewhere.keys() != state.elsewhere.keys():
        state.split_candidates = {i: own for i, own in state.split_candidates.items() if i in here}
    state.tracks, state.elsewhere = here, elsewhere


def recognise(state: MapState, event: FrameObserved, config: MappingConfig) -> list[Effect]:
    """Bring back the tracks elsewhere that observations of a keyframe match, by the rules of data association."""
    if not state.elsewhere or not event.observations:
        return []
    bounds = [bounds_of(observation.points_world) for observation in event.observations]
    near = {track.id: track for track in _near(state, bounds, config)}
    if not near:
        return []
    matches = associate(event.observations, {**state.tracks, **near}, config.lattice.points_m, config.associate)
    effects: list[Effect] = []
    for track_id in sorted({match.track_id for match in matches if match.track_id in near} - {None}):
        assert track_id is not None
        effects += _brought_back(state, near[track_id], "a keyframe sees it again")
    return effects


def merge_met(state: MapState, config: MappingConfig) -> list[Effect]:
    """Merge tracks that a correction has brought to the same place: one by where it was, one by where it is now.

    Pairs are one to one, by the IoU of their boxes first, then by the share of the smaller one's points that lie on the
    other.
    """
    effects: list[Effect] = []
    here = [track for track in state.ordered() if _can_meet(track)]
    near = [track for track in _near(state, [track.bounds for track in here], config) if _can_meet(track)]
    taken: set[int] = set()
    scored = [
        (-score, ours.id, theirs.id, theirs)
        for theirs in near
        for ours in touching(theirs.bounds, here)
        if (score := _sameness(ours, theirs, config.associate)) > 0
    ]
    for _, our_id, their_id, theirs in sorted(scored, key=lambda row: row[:3]):
        if our_id in taken or their_id in taken:
            continue
        taken |= {our_id, their_id}
        effects += _brought_back(state, theirs, f"it lies where #{our_id} is")
        kept_id, gone_id = min(our_id, their_id), max(our_id, their_id)
        effects += unite(state, kept_id, gone_id, "a correction of the poses brought them to one place", config)
    return effects


def end_elsewhere(state: MapState) -> list[Effect]:
    """Drop the tracks elsewhere that are no objects, at the end of the source."""
    effects: list[Effect] = []
    for track in list(state.elsewhere.values()):
        if not is_object(track):
            effects += drop(state, track, "structure" if track.phase is Phase.ROOM else "never confirmed")
    return effects


def moved_track(track: Track, new_from_old: NDArray[np.float64], voxel_m: float) -> Track:
    """Return a track in another frame, its cloud on the lattice there; `new_from_old` (4, 4) is rigid."""
    views = {view.name: _moved_view(view, new_from_old) for view in track.views}
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
    if not bounds:
        return
    low, high = np.array(bounds)[:, 0], np.array(bounds)[:, 1]
    for track_id in sorted(state.elsewhere):
        track = state.elsewhere[track_id]
        open_from_own = state.submaps.open_from(track.submap_id)
        center = apply(open_from_own, track.box.center[None])[0]
        reach = portable.norm(track.box.half_extents_m)
        if not ((low - reach <= center) & (center <= high + reach)).all(axis=1).any():
            continue
        yield replace(
            moved_track(track, open_from_own, config.lattice.points_m),
            submap_id=state.submaps.open_id,
            seen_in=state.submaps.open_id,
        )


def _can_meet(track: Track) -> bool:
    return track.phase is not Phase.ROOM and track.sightings >= _MIN_SIGHTINGS


def _sameness(a: Track, b: Track, config: AssociateConfig) -> float:
    """Return how surely two tracks at one place are the same object: 1 to 2 by boxes, up to 1 by points, 0 not."""
    iou = box_iou(a.box, b.box)
    if iou >= config.min_iou:
        return 1.0 + iou
    small, large = sorted((a, b), key=lambda track: (track.box.volume_m3, track.id))
    if intersection_volume_m3(small.box, large.box) < config.min_lies_on * small.box.volume_m3:
        return 0.0
    share = share_near(small.solid.keys, large.cloud)
    return share if share >= config.min_lies_on else 0.0


def _brought_back(state: MapState, track: Track, why: str) -> list[Effect]:
    """Put a track, moved into the open submap's frame, to those that lie where the odometry has them."""
    del state.elsewhere[track.id]
    ticket = track.shape_state.open_ticket
    # The answer would be where the track was.
    state.tracks[track.id] = replace(track, shape_state=replace(track.shape_state, open_ticket=None))
    state.decide("pose_correction", track.id, f"recognised in submap {state.submaps.open_id}: {why}")
    return [] if ticket is None else [CancelShape(ticket=ticket)]


def _moved_view(view: View, new_from_old: NDArray[np.float64]) -> View:
    return replace(view, world_from_camera=compose(new_from_old, view.world_from_camera))
