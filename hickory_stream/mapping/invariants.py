"""The invariants of the map's state: a sentence each, and a function that yields violations.

`validate` runs after every event in the tests of the core, and in a run with `--debug`.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import InvariantError
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.rigid import is_rigid
from hickory_stream.geometry.voxels import contains
from hickory_stream.mapping.entities.cloud import Cloud
from hickory_stream.mapping.entities.observed_space import SpaceState
from hickory_stream.mapping.entities.track import is_object
from hickory_stream.mapping.map_state import MapState


def validate(state: MapState) -> None:
    """Raise `InvariantError`, with the sentence and the violation, if an invariant of a state is broken."""
    for name, broken in INVARIANTS.items():
        for found in broken(state):
            raise InvariantError(f"the map's state is broken after keyframe {state.revision}: {name}; found {found}")


def _misplaced_tracks(state: MapState) -> Iterator[str]:
    tracks = (*state.tracks.items(), *state.elsewhere.items())
    yield from (f"#{track.id} as #{track_id}" for track_id, track in tracks if track.id != track_id)


def _divided_tracks(state: MapState) -> Iterator[str]:
    yield from (f"#{i} here and elsewhere" for i in sorted(state.tracks.keys() & state.elsewhere.keys()))
    for track in state.everywhere():
        own = state.submaps.states[track.submap_id : track.submap_id + 1]
        if own and state.submaps.is_rigid_with_open(track.submap_id) != (track.id in state.tracks):
            yield f"#{track.id} of submap {track.submap_id}"


def _numbers_to_come(state: MapState) -> Iterator[str]:
    for track in state.everywhere():
        for used in (track.id, *track.merged_ids):
            if not 1 <= used < state.next_id:
                yield f"#{used}, the next one is #{state.next_id}"
        ticket = track.shape_state.open_ticket
        if ticket is not None and not 1 <= ticket < state.next_ticket:
            yield f"job {ticket} of #{track.id}, the next one is {state.next_ticket}"


def _living_merged(state: MapState) -> Iterator[str]:
    merged = ((gone, track.id) for track in state.everywhere() for gone in track.merged_ids)
    yield from (f"#{gone} in #{i}" for gone, i in merged if gone in state.tracks or gone in state.elsewhere)


def _shared_merged(state: MapState) -> Iterator[str]:
    yield from _twice("#{}", (gone for track in state.everywhere() for gone in track.merged_ids))


def _shared_tickets(state: MapState) -> Iterator[str]:
    tickets = (track.shape_state.open_ticket for track in state.everywhere())
    yield from _twice("job {}", (ticket for ticket in tickets if ticket is not None))


def _tentative_shapes(state: MapState) -> Iterator[str]:
    jobs = ((track.shape_state.open_ticket, track.id) for track in state.everywhere() if not is_object(track))
    yield from (f"job {ticket} of #{i}" for ticket, i in jobs if ticket is not None)


def _loose_solids(state: MapState) -> Iterator[str]:
    for track in state.everywhere():
        if not contains(track.cloud.keys, track.solid.keys).all():
            yield f"other points in #{track.id}"
        if not np.array_equal(track.bounds, bounds_of(track.solid.points)):
            yield f"other bounds in #{track.id}"


def _disordered_clouds(state: MapState) -> Iterator[str]:
    clouds = [(f"#{track.id}", cloud) for track in state.everywhere() for cloud in (track.cloud, track.solid)]
    candidates = state.split_candidates.items()
    clouds += [(f"a part of #{host}", candidate.cloud) for host, own in candidates for candidate in own]
    yield from (f"that of {name}" for name, cloud in clouds if not _is_cloud(cloud))


def _times_to_come(state: MapState) -> Iterator[str]:
    late = [track for track in state.everywhere() if track.seen_clock_ns > state.clock_ns]
    yield from (f"#{track.id} at {track.seen_clock_ns}, and now is {state.clock_ns}" for track in late)


def _foreign_views(state: MapState) -> Iterator[str]:
    held = ((view.object_id, track.id) for track in state.everywhere() for view in track.views)
    yield from (f"a view of #{own} in #{i}" for own, i in held if own != i)
    pending = () if state.pending is None else state.pending.candidates.values()
    missing = (view.object_id for view in pending if view.object_id not in state.tracks)
    yield from (f"a candidate of #{i}, which is not there" for i in missing)


def _unkept_views(state: MapState) -> Iterator[str]:
    yield from (f"{name}, which is needed" for name in sorted(state.view_names() - state.kept_views))


def _unneeded_views(state: MapState) -> Iterator[str]:
    # While features are pending, pixels of candidate views are kept although no track refers to them yet.
    if state.pending is None:
        yield from (f"{name}, which nothing needs" for name in sorted(state.kept_views - state.view_names()))


def _unordered_votes(state: MapState) -> Iterator[str]:
    rows = state.votes.rows
    known = {track.id for track in state.everywhere()}
    for a, row in rows.items():
        for b, votes in row.votes.items():
            if a == b or not {a, b} <= known or b not in rows or rows[b].votes.get(a) != votes:
                yield f"#{a} and #{b}"


def _dead_hosts(state: MapState) -> Iterator[str]:
    yield from (f"those of #{host}" for host in state.split_candidates if host not in state.tracks)
    known = {track.id for track in state.everywhere()}
    yield from (f"those of #{host}" for host in state.absorbed if host not in known)


def _foreign_histories(state: MapState) -> Iterator[str]:
    known = {**state.tracks, **state.elsewhere}
    pairs = ((host, track.id) for host, absorbed in state.absorbed.items() for track in absorbed if host in known)
    yield from (f"#{i} in #{host}" for host, i in pairs if i not in known[host].merged_ids)


def _shared_histories(state: MapState) -> Iterator[str]:
    yield from _twice("#{}", (track.id for absorbed in state.absorbed.values() for track in absorbed))


def _foreign_joins(state: MapState) -> Iterator[str]:
    known = {**state.tracks, **state.elsewhere}
    yield from (f"those of #{host_id}" for host_id in state.joins if host_id not in known)
    pairs = ((host_id, join.far.id) for host_id, joins in state.joins.items() if host_id in known for join in joins)
    yield from (f"#{far} in #{host}" for host, far in pairs if far not in (host, *known[host].merged_ids))


def _disordered_submaps(state: MapState) -> Iterator[str]:
    submaps = state.submaps
    ids = [submap.id for submap in submaps.states]
    if ids != list(range(len(ids))) or not 0 <= submaps.since_jump <= submaps.first < max(len(ids), 1):
        yield f"submaps {ids}, the first since the last jump is {submaps.since_jump}, judged by {submaps.first} on"
    yield from (f"no rigid pose of submap {s.id}" for s in submaps.states if not is_rigid(s.world_from_submap))


def _homeless_tracks(state: MapState) -> Iterator[str]:
    for track in state.everywhere():
        if not 0 <= track.submap_id <= track.seen_in <= state.submaps.open_id:
            yield f"#{track.id} of submap {track.submap_id}, seen in {track.seen_in} of {state.submaps.open_id}"


def _misowned_voxels(state: MapState) -> Iterator[str]:
    submaps = state.submaps
    if len(submaps.owned) != len(submaps.owners) or not _ascends(submaps.owned):
        yield "a voxel twice, or one without an owner"
    elif ((submaps.owners < submaps.first) | (submaps.owners >= submaps.open_id)).any():
        yield f"an owner that is not between {submaps.first} and {submaps.open_id}"


def _other_judges(state: MapState) -> Iterator[str]:
    submaps = state.submaps
    if submaps.first == submaps.open_id and not _is_same_space(submaps.space, submaps.states[-1].seen):
        yield "another space"


def _disordered_spaces(state: MapState) -> Iterator[str]:
    spaces = [("that since the last jump", state.submaps.space)]
    for submap in state.submaps.states:
        spaces += [(f"that of submap {submap.id}", submap.space), (f"that seen in submap {submap.id}", submap.seen)]
    for name, space in spaces:
        if not (_ascends(space.free) and _ascends(space.hidden_free) and _ascends(space.surface)):
            yield f"{name}, out of order"
        elif contains(space.free, space.surface[space.is_structure]).any():
            yield f"{name}, with free structure"


INVARIANTS: dict[str, Callable[[MapState], Iterator[str]]] = {
    "the key of every track is its id": _misplaced_tracks,
    "a track is elsewhere if and only if its submap was moved against the open one": _divided_tracks,
    "ids and tickets in use are below the next ones to be given": _numbers_to_come,
    "a merged track is removed": _living_merged,
    "a track is merged into only one other": _shared_merged,
    "a shape job belongs to only one track": _shared_tickets,
    "a tentative track has no shape job": _tentative_shapes,
    "a cloud has each voxel once, in order, with finite points and equal array lengths": _disordered_clouds,
    "the solid part and the bounds of a track agree with its cloud": _loose_solids,
    "no track was seen later than the clock": _times_to_come,
    "a view belongs to the track that holds it": _foreign_views,
    "the pixels of all views in use are kept": _unkept_views,
    "no pixels of unused views are kept": _unneeded_views,
    "votes are of pairs of tracks, the lower id first": _unordered_votes,
    "split candidates and absorbed tracks belong to an existing track": _dead_hosts,
    "an absorbed track is listed among the merged ids of its host": _foreign_histories,
    "a track is absorbed by only one other": _shared_histories,
    "joins belong to an existing track, which is the far one or has it among its merged ids": _foreign_joins,
    "submaps are numbered in order and have rigid poses": _disordered_submaps,
    "a track is last seen in its own submap or a later one, at most the open one": _homeless_tracks,
    "a voxel is owned by only one closed submap since the last jump": _misowned_voxels,
    "if decisions are made against the open submap alone, it is against what was seen in it": _other_judges,
    "the voxels of an observed space are in order, and no structure is free": _disordered_spaces,
}


def _twice(text: str, items: Iterable[int]) -> Iterator[str]:
    yield from (f"{text.format(item)} twice" for item, count in sorted(Counter(items).items()) if count > 1)


def _ascends(keys: NDArray[np.int64]) -> bool:
    return bool((keys[1:] > keys[:-1]).all())


def _is_cloud(cloud: Cloud) -> bool:
    sizes = {len(cloud.keys), len(cloud.points), len(cloud.colors), len(cloud.hits), len(cloud.weights)}
    return len(sizes) == 1 and _ascends(cloud.keys) and bool(np.isfinite(cloud.points).all())


def _is_same_space(a: SpaceState, b: SpaceState) -> bool:
    pairs = ((a.free, b.free), (a.hidden_free, b.hidden_free), (a.surface, b.surface), (a.hits, b.hits))
    return a.floor_z_m == b.floor_z_m and all(np.array_equal(x, y) for x, y in (*pairs, (a.misses, b.misses)))
