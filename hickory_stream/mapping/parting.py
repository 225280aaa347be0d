"""Parting: a join of two tracks is taken back once the submaps lie so that the two are at one place no more.

A loop may be wrong, and be withdrawn. A join stands while its far track lies, as the submaps are placed now, where it
was joined, or on what else its host is. Otherwise it is itself again, as it was in its own submap, and the host is what
it was without it, with all that keyframes have added since.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import apply
from hickory_stream.mapping.absorbed import after_parting
from hickory_stream.mapping.cloud import fuse, grown_since
from hickory_stream.mapping.existence import no_evidence, plus_since
from hickory_stream.mapping.joins import Join, Past, with_join
from hickory_stream.mapping.lifecycle import LifeEvent, first_phase, is_sure
from hickory_stream.mapping.moved_tracks import sameness
from hickory_stream.mapping.track import new_track, sketched, with_cloud, without_views
from hickory_stream.mapping.track_endings import cancelled
from hickory_stream.mapping.views import better, covers_better
from hickory_stream.records import Phase

if TYPE_CHECKING:
    from hickory_stream.events import Effect
    from hickory_stream.mapping.cloud import Cloud
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.track import Track

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
    voxel_m, united = config.lattice.points_m, join.united
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
    rest = _with_views(rest, without_views(host, {view.name for view in join.far.views}), config)
    if is_seen and (host.phase is Phase.ROOM or is_sure(rest, config.lifecycle)):
        rest = replace(rest, phase=host.phase)
    return sketched(rest, config.track)


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


def _with_views(track: Track, other: Track, config: MappingConfig) -> Track:
    """Return a track with its views under its own id, and those of another one that are better."""
    coverage = {sector: replace(view, object_id=track.id) for sector, view in track.coverage}
    best = None if track.best_view is None else replace(track.best_view, object_id=track.id)
    for sector, view in other.coverage:
        own = replace(view, object_id=track.id)
        if covers_better(own, coverage.get(sector), config.views):
            coverage[sector] = own
    if other.best_view is not None:
        best = better(best, replace(other.best_view, object_id=track.id))
    return replace(track, coverage=tuple(sorted(coverage.items())), best_view=best)


def _without_job(track: Track) -> Track:
    return replace(track, shape_state=replace(track.shape_state, open_ticket=None))
