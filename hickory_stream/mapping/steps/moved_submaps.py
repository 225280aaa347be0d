"""Tracks of submaps that a correction has moved against the open one: set apart, and brought back when seen again.

New frames go on in the frame of the odometry, which is that of the open submap. A track of a submap that was placed
elsewhere does not lie there any more: it keeps its data in its own submap, moves with it, and takes no part in the data
association, until an observation matches it where it lies now. Then its data are brought into the open submap's frame,
once, and it is a track like all others. Two tracks that a correction brings together are one object: they are merged.
Both are kept as joins: a later correction that takes them to different places takes them back (`parting`).

A track in another frame, and whether two tracks that lie at one place are the same object.

Parting: a join of two tracks is taken back once the submaps lie so that the two are at one place no more.

A loop may be wrong, and be withdrawn. A join stands while its far track lies, as the submaps are placed now, where it
was joined, or on what else its host is. Otherwise it is itself again, as it was in its own submap, and the host is what
it was without it, with all that keyframes have added since.
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
from hickory_stream.mapping.entities.cloud import fuse, grown_since, moved_cloud, share_near
from hickory_stream.mapping.entities.existence import Existence, no_evidence, plus_since
from hickory_stream.mapping.entities.rigid_motion import moved_box, moved_shape, moved_view
from hickory_stream.mapping.entities.submaps import placed_at
from hickory_stream.mapping.entities.track import is_object, new_track, sketched, with_cloud, without_views
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.entities.views import better, covers_better, sector_of
from hickory_stream.mapping.rules.association import associate, one_to_one
from hickory_stream.mapping.rules.lifecycle import LifeEvent, first_phase, is_sure
from hickory_stream.mapping.rules.merge_history import Join, Past, after_parting, with_join
from hickory_stream.mapping.rules.space_agreement import agreed_anew
from hickory_stream.mapping.steps.endings import cancelled, drop, rest_elsewhere, unite
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from numpy.typing import NDArray

    from hickory_stream.events import Effect, FrameObserved, PosesCorrected
    from hickory_stream.mapping.config import MappingConfig
    from hickory_stream.mapping.entities.cloud import Cloud
    from hickory_stream.mapping.entities.submaps import Submaps
    from hickory_stream.mapping.entities.track import Track
    from hickory_stream.mapping.map_state import MapState


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


def sameness(a: Track, b: Track, a_from_b: NDArray[np.float64], config: MappingConfig) -> float:
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
    own = moved_cloud(b.solid, a_from_b, config.voxels.object_m)
    share = share_near(a.solid.keys, own) if a_is_small else share_near(own.keys, a.cloud)
    return share if share >= associate_config.min_lies_on else 0.0


_STANDS_M = 0.2
"""A join stands if its far track now lies within this of where it was joined: later corrections of true loops move it
less, and loops between places that look alike are wrong by more."""


def past_of(state: MapState, track_id: int) -> Past:
    """Take out of the state, and return, what refers to a track that is about to be joined to another one."""
    return Past(
        votes=dict(state.votes.all_of(track_id)),
        absorbed=state.absorbed.get(track_id, ()),
        joins=state.joins.pop(track_id, ()),
    )


def keep_join(state: MapState, host_id: int, far: Track, past: Past, near: Track | None) -> None:
    """Keep the join that has just made a host of a far track and a near one, each as it was before."""
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


def part_joins(state: MapState, config: MappingConfig) -> tuple[list[Effect], set[int]]:
    """Part the joins that do not stand as the submaps are placed now; return the ids of the tracks that came of it.

    Which of these lie where the odometry has them is left to the caller (`moved_submaps.set_apart`).
    """
    effects: list[Effect] = []
    parted: set[int] = set()
    while (broken := _broken(state, config)) is not None:
        more, ids = _part(state, *broken, config)
        effects += more
        parted |= ids
    return effects, parted


def _broken(state: MapState, config: MappingConfig) -> tuple[int, int] | None:
    """Return a join that does not stand: its host and its place among the host's; the last one of the first host."""
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
    return rest is not None and sameness(rest, join.far, host_from_far, config) > 0


def _part(state: MapState, host_id: int, i: int, config: MappingConfig) -> tuple[list[Effect], set[int]]:
    """Part the i-th join of a host; return the ids of what it was made of."""
    tracks = state.tracks if host_id in state.tracks else state.elsewhere
    host, own = tracks.pop(host_id), state.joins.pop(host_id)
    join, far = own[i], own[i].far
    rest_id = _id_of_rest(state, host, join)
    rest = _rest(host, join, rest_id, config)
    tracks[far.id] = far
    if rest is not None:
        tracks[rest_id] = rest
        state.next_id = max(state.next_id, rest_id + 1)
    past, known = join.past, {track.id for track in state.everywhere()}
    if join.near is not None:
        past = replace(past, votes={rest_id if a == join.near.id else a: v for a, v in past.votes.items()})
    votes = {a: own_votes for a, own_votes in past.votes.items() if a in known and a != far.id}
    state.votes = state.votes.parted(host_id, rest_id, far.id, votes)
    state.votes = state.votes if rest is not None else state.votes.without(rest_id)
    state.absorbed = after_parting(state.absorbed, host_id, join.far_ids, None if rest is None else rest_id)
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
        state.decide(
            "part", back_id, f"{text}: the correction that had joined the two is taken back", other_id=other_id
        )
    return cancelled(host), {far.id} if rest is None else {far.id, rest_id}


def _id_of_rest(state: MapState, host: Track, join: Join) -> int:
    """Return the id of a host without its far track: its own, else the lowest of those merged, else a new one."""
    if host.id not in join.far_ids:
        return host.id
    return min({*host.merged_ids} - join.far_ids, default=state.next_id)


def _without_far(other: Join, join: Join, rest_id: int, config: MappingConfig) -> Join:
    """Return another join of a host without the far track of one that was parted, if that was in it."""
    if join.far.id not in (other.united.id, *other.united.merged_ids):
        return other
    united = _rest(other.united, join, rest_id, config)
    near = None if other.near is None else _rest(other.near, join, rest_id, config)
    return replace(other, united=other.united if united is None else united, near=near)


def _rest(host: Track, join: Join, rest_id: int, config: MappingConfig) -> Track | None:
    """Return a host without the far track of a join: as it was, with all that it has gained since; None: nothing."""
    voxel_m, united = config.voxels.object_m, join.united
    gained = grown_since(host.cloud, united.cloud, voxel_m)
    rest = join.near
    if rest is None:
        if len(gained.keys) == 0:
            return None
        rest = _of_nothing(host, gained, join.stamp_ns, voxel_m)
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
        existence=plus_since(rest.existence, host.existence, united.existence),
    )
    rest = _with_views(rest, without_views(host, {view.name for view in join.far.views}))
    if is_seen and (host.phase is Phase.ROOM or is_sure(rest, config.lifecycle)):
        rest = replace(rest, phase=host.phase)
    return sketched(rest)


def _of_nothing(host: Track, gained: Cloud, stamp_ns: int, voxel_m: float) -> Track:
    """Return the track of what a host has gained since a stamp, without any sighting, view or shape yet."""
    return new_track(
        host.id,
        gained,
        phase=first_phase(LifeEvent.BORN),
        stamp_ns=stamp_ns,
        clock_ns=host.seen_clock_ns,
        sightings=0,
        submap_id=host.submap_id,
        existence=no_evidence(),
        voxel_m=voxel_m,
    )


def _with_views(track: Track, other: Track) -> Track:
    """Return a track with its views under its own id, and those of another one that are better."""
    coverage = {sector: replace(view, object_id=track.id) for sector, view in track.coverage}
    best = None if track.best_view is None else replace(track.best_view, object_id=track.id)
    for sector, view in other.coverage:
        own = replace(view, object_id=track.id)
        if covers_better(own, coverage.get(sector)):
            coverage[sector] = own
    if other.best_view is not None:
        best = better(best, replace(other.best_view, object_id=track.id))
    return replace(track, coverage=tuple(sorted(coverage.items())), best_view=best)


def _without_job(track: Track) -> Track:
    return replace(track, shape_state=replace(track.shape_state, open_ticket=None))


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
    matches = associate(event.observations, known, config.voxels.object_m, config.associate)
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
        there = moved_track(far, near_from_far, config.voxels.object_m)
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
    moved_there = moved_track(track, state.submaps.open_from(track.submap_id), config.voxels.object_m)
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
