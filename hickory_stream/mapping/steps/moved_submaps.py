"""Tracks of submaps that a correction has moved against the open one.

Keyframes are in the frame of the open submap. A track of a submap that was placed elsewhere keeps its data in its own
submap, without data association, until an observation matches it where it lies now; then its data are brought into the
open frame. Two tracks that a correction brings together are merged, and kept as joins. A join stands while its far
track lies where it was joined, or on the rest of its host; otherwise it is taken back, e.g. for a withdrawn loop.
"""

from collections.abc import Collection, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.events import Effect, FrameObserved, PosesCorrected
from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.boxes import box_iou, intersection_volume_m3
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import moved
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.derived import PlacedTrack
from hickory_stream.mapping.entities.cloud import fuse, grown_since, moved_cloud, share_near
from hickory_stream.mapping.entities.rigid_motion import moved_box, moved_shape, moved_view
from hickory_stream.mapping.entities.submaps import Submaps, placed_at
from hickory_stream.mapping.entities.track import Track, is_object, new_track, sketched, with_cloud, without_views
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.entities.views import sector_of
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules.association import associate, one_to_one
from hickory_stream.mapping.rules.lifecycle import LifeEvent, first_phase, is_sure
from hickory_stream.mapping.rules.merge_history import Join, Past, after_unmerge, with_join
from hickory_stream.mapping.rules.merging import with_better_views
from hickory_stream.mapping.rules.space_agreement import agreed_after_placement
from hickory_stream.mapping.steps.endings import cancelled, compress_elsewhere, drop, unite


def moved_track(track: Track, new_from_old: NDArray[np.float64], voxel_m: float) -> Track:
    """Return a track in another frame, its cloud on the lattice there; `new_from_old` (4, 4) is rigid."""
    views = {view.name: moved_view(view, new_from_old) for view in track.views}
    there = replace(
        with_cloud(track, moved_cloud(track.cloud, new_from_old, voxel_m), track.sightings, voxel_m),
        best_view=None if track.best_view is None else views[track.best_view.name],
        shape=None if track.shape is None else moved_shape(track.shape, new_from_old),
        sketch=None if track.sketch is None else moved(track.sketch, new_from_old),
    )
    kept = [views[view.name] for _, view in track.coverage]
    sectors = {sector_of(view, there.box.center): view for view in kept}
    return replace(there, coverage=tuple(sorted(sectors.items())))


def _sameness(a: Track, b: Track, a_from_b: NDArray[np.float64], config: MappingConfig) -> float:
    # How surely two tracks at one place are the same object: 1 to 2 by boxes, up to 1 by points, 0 not.
    there = moved_box(b.box, a_from_b)
    iou = box_iou(a.box, there)
    if iou >= config.associate.min_iou:
        return 1.0 + iou
    least = min(a.box.volume_m3, b.box.volume_m3)
    if intersection_volume_m3(a.box, there) < config.associate.min_lies_on * least:
        return 0.0
    own = moved_cloud(b.solid, a_from_b, config.voxels.object_m)
    a_is_small = a.box.volume_m3 < b.box.volume_m3
    share = share_near(a.solid.keys, own) if a_is_small else share_near(own.keys, a.cloud)
    return share if share >= config.associate.min_lies_on else 0.0


# A join stands if its far track lies within this of the place of the join: later corrections of true loops move it
# less, and loops between places that look alike are wrong by more.
_STANDS_M = 0.2


def _past_of(state: MapState, track_id: int) -> Past:
    return Past(
        votes=dict(state.votes.all_of(track_id)),
        absorbed=state.absorbed.get(track_id, ()),
        joins=state.joins.pop(track_id, ()),
    )


def _keep_join(state: MapState, host_id: int, far: Track, past: Past, near: Track | None) -> None:
    host = state.track(host_id)
    host_from_far = state.submaps.between(host.submap_id, far.submap_id)
    join = Join(
        far=_without_job(far),
        past=past,
        at=apply(host_from_far, far.box.center[None])[0],
        near=None if near is None else _without_job(near),
        united=host,
        stamp_ns=state.stamp_ns or 0,
    )
    state.joins = with_join(state.joins, host_id, join)


def _unmerge_joins(state: MapState, config: MappingConfig) -> tuple[list[Effect], set[int]]:
    effects: list[Effect] = []
    unmerged: set[int] = set()
    while (broken := _broken(state, config)) is not None:
        more, ids = _unmerge(state, *broken, config)
        effects += more
        unmerged |= ids
    return effects, unmerged


def _broken(state: MapState, config: MappingConfig) -> tuple[int, int] | None:
    # A join that does not stand: its host and its index; the last one of the first host.
    for host_id in sorted(state.joins):
        for i in reversed(range(len(state.joins[host_id]))):
            if not _stands(state, state.track(host_id), state.joins[host_id][i], config):
                return host_id, i
    return None


def _stands(state: MapState, host: Track, join: Join, config: MappingConfig) -> bool:
    if not all(_stands(state, join.far, inner, config) for inner in join.past.joins):
        return False
    host_from_far = state.submaps.between(host.submap_id, join.far.submap_id)
    if portable.norm(apply(host_from_far, join.far.box.center[None])[0] - join.at) <= _STANDS_M:
        return True
    rest = _rest(host, join, host.id, config)
    return rest is not None and _sameness(rest, join.far, host_from_far, config) > 0


def _unmerge(state: MapState, host_id: int, i: int, config: MappingConfig) -> tuple[list[Effect], set[int]]:
    tracks = state.tracks if host_id in state.tracks else state.elsewhere
    host, own = tracks.pop(host_id), state.joins.pop(host_id)
    join, far = own[i], own[i].far
    # Its own id, else the lowest of the merged ones, else a new one.
    is_own = host.id not in join.far_ids
    rest_id = host.id if is_own else min({*host.merged_ids} - join.far_ids, default=state.next_id)
    rest = _rest(host, join, rest_id, config)
    tracks[far.id] = far
    if rest is not None:
        tracks[rest_id] = rest
        state.next_id = max(state.next_id, rest_id + 1)
    past, known = join.past, {track.id for track in state.everywhere()}
    if join.near is not None:
        past = replace(past, votes={rest_id if a == join.near.id else a: v for a, v in past.votes.items()})
    votes = {a: v for a, v in past.votes.items() if a in known and a != far.id}
    state.votes = state.votes.unmerged(host_id, rest_id, far.id, votes)
    state.votes = state.votes if rest is not None else state.votes.without(rest_id)
    state.absorbed = after_unmerge(state.absorbed, host_id, join.far_ids, None if rest is None else rest_id)
    if past.absorbed:
        state.absorbed = {**state.absorbed, far.id: past.absorbed}
    if past.joins:
        state.joins[far.id] = past.joins
    left = tuple(_without_far(other, join, rest_id, config) for other in (*own[:i], *own[i + 1 :]))
    if left and rest is not None:
        state.joins[rest_id] = left
    state.split_candidates.pop(host_id, None)
    back_id, other_id = (rest_id, far.id) if host_id == far.id else (far.id, host_id)
    text = f"#{far.id} of submap {far.submap_id} does not lie there any more"
    if back_id != rest_id or rest is not None:
        text += ": the correction that had joined the two is taken back"
        state.decide("part", back_id, text, other_id=other_id)
    return cancelled(host), {far.id} if rest is None else {far.id, rest_id}


def _without_far(other: Join, join: Join, rest_id: int, config: MappingConfig) -> Join:
    if join.far.id not in (other.united.id, *other.united.merged_ids):
        return other
    united = _rest(other.united, join, rest_id, config)
    near = None if other.near is None else _rest(other.near, join, rest_id, config)
    return replace(other, united=other.united if united is None else united, near=near)


def _rest(host: Track, join: Join, rest_id: int, config: MappingConfig) -> Track | None:
    # A host without the far track of a join, with everything gained since; None: nothing is left.
    voxel_m, united = config.voxels.object_m, join.united
    gained = grown_since(host.cloud, united.cloud, voxel_m)
    rest = join.near
    if rest is None:
        if len(gained.keys) == 0:
            return None
        rest = new_track(
            host.id,
            gained,
            phase=first_phase(LifeEvent.BORN),
            stamp_ns=join.stamp_ns,
            clock_ns=host.seen_clock_ns,
            sightings=0,
            submap_id=host.submap_id,
            voxel_m=voxel_m,
        )
    elif len(gained.keys):
        rest = with_cloud(rest, fuse(rest.cloud, gained), rest.sightings, voxel_m)
    is_seen = host.last_seen_ns > united.last_seen_ns
    last = host if is_seen else rest
    rest = replace(
        rest,
        id=rest_id,
        merged_ids=tuple(sorted({*host.merged_ids} - join.far_ids - {rest_id})),
        sightings=rest.sightings + max(host.sightings - united.sightings, 0),
        last_seen_ns=last.last_seen_ns,
        seen_clock_ns=last.seen_clock_ns,
        seen_in=last.seen_in,
        observed_ns=rest.observed_ns + max(host.observed_ns - united.observed_ns, 0),
    )
    rest = with_better_views(rest, without_views(host, {view.name for view in join.far.views}))
    if is_seen and is_sure(rest, config.lifecycle):
        rest = replace(rest, phase=host.phase)
    return sketched(rest)


def _without_job(track: Track) -> Track:
    return replace(track, shape_state=replace(track.shape_state, open_ticket=None))


_MIN_SIGHTINGS = 2
# Boxes with this IoU plus 1 are one object, whatever moved them.
_SURE = 1.4
# A correction joins two tracks only if their score grows by more than this.
_CLOSER = 0.1


def place_submaps(state: MapState, event: PosesCorrected, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Set corrected poses of submaps; take back joins, set tracks apart, and merge tracks at one place (`merges`)."""
    state.graph = state.graph if event.graph is None else event.graph
    if event.graph is not None and not event.submap_ids:
        return []
    before = state.submaps
    places = dict(zip(event.submap_ids, event.world_from_submap, strict=True))
    state.submaps = agreed_after_placement(placed_at(before, places), before)
    ids = ", ".join(map(str, event.submap_ids)) or "none"
    state.decide("pose_correction", None, f"submaps {ids} were placed anew")
    effects, unmerged = _unmerge_joins(state, config)
    _set_apart(state)
    if merges:
        effects += _merge_met(state, before, config, unmerged)
    compress_elsewhere(state)
    return effects


def _set_apart(state: MapState) -> None:
    here: dict[int, Track] = {}
    elsewhere: dict[int, Track] = {}
    for track in state.everywhere():
        (here if state.submaps.is_rigid_with_open(track.submap_id) else elsewhere)[track.id] = track
    if elsewhere.keys() != state.elsewhere.keys():
        state.split_candidates = {i: own for i, own in state.split_candidates.items() if i in here}
    state.tracks, state.elsewhere = TrackTable(here), TrackTable(elsewhere)
    state.stirred = set(here)


def recognise(state: MapState, event: FrameObserved, config: MappingConfig) -> list[Effect]:
    """Bring back the tracks elsewhere that observations of a keyframe match."""
    if not state.elsewhere or not event.observations:
        return []
    bounds = [bounds_of(observation.points_world) for observation in event.observations]
    near = {track.id: track for track in _near(state, bounds, config)}
    if not near:
        return []
    state.derived.warm.use(near, state.revision)
    known = TrackTable({track.id: track for one in bounds for track in state.tracks.touching(one)} | near)
    matches = associate(event.observations, known, config.voxels.object_m, config.associate)
    effects: list[Effect] = []
    for track_id in sorted(near.keys() & {match.track_id for match in matches}):
        far, past = state.elsewhere[track_id], _past_of(state, track_id)
        effects += _brought_back(state, near[track_id], "a keyframe sees it again")
        _keep_join(state, track_id, far, past, None)
    return effects


def _merge_met(state: MapState, before: Submaps, config: MappingConfig, unmerged: Collection[int] = ()) -> list[Effect]:
    # Pairs are one to one, by IoU, then by points. Two that lay like this before, or that keyframes segmented apart,
    # stay two: a thing and its content. Tracks of `unmerged` lay nowhere before.
    effects: list[Effect] = []
    while met := sorted(_met(state, before, config, unmerged)):
        for kept_id, gone_id in one_to_one(((a, b) for _, a, b in met), of_one_kind=True):
            effects += _united(state, kept_id, gone_id, config)
    return effects


def _united(state: MapState, kept_id: int, gone_id: int, config: MappingConfig) -> list[Effect]:
    # Into the frame of the one that is seen, if one is.
    far_id, near_id = (kept_id, gone_id) if gone_id in state.tracks else (gone_id, kept_id)
    far, near, past = state.track(far_id), state.track(near_id), _past_of(state, far_id)
    effects: list[Effect] = []
    # Where both lie where the odometry has them, their data are in one frame already.
    if far_id in state.elsewhere and near_id in state.tracks:
        there = _in_open_frame(state, far, config)
        effects += _brought_back(state, there, f"it lies where #{near_id} is")
    elif far_id in state.elsewhere:
        near_from_far = state.submaps.between(near.submap_id, far.submap_id)
        there = moved_track(far, near_from_far, config.voxels.object_m)
        state.elsewhere[far_id] = replace(there, submap_id=near.submap_id)
    effects += unite(state, kept_id, gone_id, "a correction of the poses brought them to one place", config)
    _keep_join(state, kept_id, far, past, near)
    return effects


def _met(
    state: MapState, before: Submaps, config: MappingConfig, unmerged: Collection[int]
) -> Iterator[tuple[float, int, int]]:
    # (-score, lower id, higher id) of tracks of submaps that were moved against each other, now at one place.
    everywhere = state.everywhere()
    tracks = [t for t in everywhere if t.sightings >= _MIN_SIGHTINGS]
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
            is_anew = a.id in unmerged or b.id in unmerged
            if (np.array_equal(a_from_b, then) and not is_anew) or state.votes.of(a.id, b.id).apart_ns:
                continue
            score = _sameness(a, b, a_from_b, config)
            if score >= _SURE or (score > 0 and (is_anew or score > _sameness(a, b, then, config) + _CLOSER)):
                yield -score, a.id, b.id


def end_elsewhere(state: MapState, config: MappingConfig, *, merges: bool) -> list[Effect]:
    """Merge tracks elsewhere with those at their places, at the end of the source; drop those that are no objects."""
    effects = _merge_met(state, state.submaps, config, tuple(state.elsewhere)) if merges else []
    lost = [track for track in state.elsewhere.values() if not is_object(track)]
    for track in lost:
        effects += drop(state, track, "never confirmed")
    return effects


def _near(state: MapState, bounds: list[NDArray[np.float32]], config: MappingConfig) -> Iterator[Track]:
    low, high = np.array(bounds)[:, 0], np.array(bounds)[:, 1]
    placed = state.derived.placed = {track.id: _placed(state, track) for track in state.elsewhere.ordered()}
    centers = np.array([own.center for own in placed.values()])[:, None]
    reach = np.array([own.radius_m for own in placed.values()], low.dtype)[:, None, None]
    is_apart = (low - reach > centers) | (centers > high + reach)
    for own, apart in zip(placed.values(), np.any(is_apart, axis=2).tolist(), strict=True):
        own.moved = None if all(apart) else own.moved or _in_open_frame(state, own.track, config)
        if own.moved is not None:
            yield _of_open(state, own.moved)


def _placed(state: MapState, track: Track) -> PlacedTrack:
    submaps, known = state.submaps, state.derived.placed.get(track.id)
    places = submaps.world_from(track.submap_id), submaps.world_from(submaps.open_id)
    if known is not None and known.track is track and all(a is b for a, b in zip(known.places, places, strict=True)):
        return known
    center = apply(submaps.open_from(track.submap_id), track.box.center[None])[0]
    return PlacedTrack(track, places, center, portable.norm(track.box.half_extents_m))


def _in_open_frame(state: MapState, track: Track, config: MappingConfig) -> Track:
    place = state.submaps.open_from(track.submap_id)
    return _of_open(state, moved_track(track, place, config.voxels.object_m))


def _of_open(state: MapState, track: Track) -> Track:
    return replace(track, submap_id=state.submaps.open_id, seen_in=state.submaps.open_id)


def _brought_back(state: MapState, track: Track, why: str) -> list[Effect]:
    del state.elsewhere[track.id]
    # A job's result would lie where the track was.
    state.tracks[track.id] = _without_job(track)
    state.decide("pose_correction", track.id, f"recognised in submap {state.submaps.open_id}: {why}")
    return cancelled(track)
