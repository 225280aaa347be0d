"""Splitting of tracks: a part that keyframes segment apart often enough becomes a track of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.mapping.absorbed import after_split, recalled, restored, without_views_of
from hickory_stream.mapping.cloud import is_near, share_near, solid_part, without
from hickory_stream.mapping.existence import Existence
from hickory_stream.mapping.joins import without_far
from hickory_stream.mapping.lifecycle import LifeEvent, first_phase
from hickory_stream.mapping.track import new_track, with_cloud
from hickory_stream.mapping.track_merging import pair_of, why_one

if TYPE_CHECKING:
    from collections.abc import Mapping

    from hickory_stream.events import FrameObserved
    from hickory_stream.mapping.map_state import MapState
    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.mapping.sighting import Sighting
    from hickory_stream.mapping.split_candidates import SplitCandidate


def split_tracks(state: MapState, event: FrameObserved, hosts: set[int], config: MappingConfig) -> dict[int, int]:
    """Split off the candidates that are objects; return the ids of their hosts by the new ids."""
    promoted: dict[int, int] = {}
    for host_id in sorted(hosts & state.split_candidates.keys()):
        for candidate in state.split_candidates[host_id]:
            if not candidate.is_object(config.split):
                continue
            if (new := _split_off(state, event, host_id, candidate, config)) is not None:
                promoted[new] = host_id
                left = (other for other in state.split_candidates[host_id] if other is not candidate)
                state.split_candidates[host_id] = tuple(left)
    return promoted


def moved_out(
    state: MapState, sightings: list[Sighting], promoted: Mapping[int, int], config: MappingConfig
) -> list[Sighting]:
    """Return the sightings after splits: masks that showed a split-off part are reassigned to its new track."""
    moved = list(sightings)
    for new_id, host_id in promoted.items():
        for i, sighting in enumerate(sightings):
            lies_on = share_near(sighting.cloud.keys, state.tracks[new_id].cloud) if sighting.is_part else 0.0
            if sighting.track_id == host_id and lies_on >= config.split.same_share:
                moved[i] = replace(sighting, is_part=False, track_id=new_id)
                text = f"its mask shows what was a part of #{host_id}"
                state.decide("associate", new_id, text, observation_index=sighting.observation.index)
    return moved


def _split_off(
    state: MapState, event: FrameObserved, host_id: int, candidate: SplitCandidate, config: MappingConfig
) -> int | None:
    """Make a track of a candidate and remove its points from the host; return its id.

    None if the candidate is too small, or if its support relation to the host says that it is a part of it.
    """
    split, voxel_m = config.split, config.lattice.points_m
    host = state.tracks[host_id]
    rest = without(host.cloud, is_near(host.cloud.keys, candidate.cloud))
    if len(rest.keys) < split.min_voxels:
        return None
    num_apart = len(candidate.frames)
    cloud = solid_part(candidate.cloud, num_apart)
    new = new_track(
        state.next_id,
        cloud,
        phase=first_phase(LifeEvent.SPLIT_OFF),
        stamp_ns=event.stamp_ns,
        clock_ns=state.clock_ns,
        sightings=num_apart,
        submap_id=state.submaps.open_id,
        # The keyframes that segmented it apart count as its sightings.
        existence=Existence(evidence=float(num_apart), places=event.world_from_camera[None, :3, 3]),
        voxel_m=voxel_m,
    )
    size = np.sort(2 * new.box.half_extents_m)
    if size[0] < split.min_size_m or size[1] < 2 * split.min_size_m:
        return None
    left = with_cloud(host, rest, host.sightings, voxel_m)
    pair = pair_of(host_id, new.id)
    votes = state.votes.plus([pair], apart=num_apart).plus([pair], together=candidate.together)
    small, large = (new, left) if new.box.volume_m3 <= left.box.volume_m3 else (left, new)
    near = [track for track in state.tracks.touching(new.bounds) if track.id != host_id]
    graph = state.support_graph(config)
    is_part = graph.still_part_of(small, large, near, inside=split.part_inside, max_volume=split.part_volume)
    if is_part is not None or why_one(left, new, near, votes, graph, config.merge) is not None:
        return None
    state.next_id += 1
    state.votes = votes
    # Its points came from the host: they are in the host's submap.
    new = replace(new, is_promoted=True, submap_id=host.submap_id)
    text = f"seen apart from #{host_id} in {num_apart} keyframes, as one in {candidate.together}"
    before = recalled(state.absorbed, host_id, cloud, split.same_share)
    if before is None and (before := recalled(state.absorbed, host_id, left.solid, split.same_share)) is not None:
        # The candidate is the original host, and the remaining points are the track that was merged into the host.
        rest_of_host = left.cloud
        # The host keeps its id and sightings, with the candidate's cloud.
        left = replace(with_cloud(host, cloud, num_apart, voxel_m), sightings=host.sightings)
        new = with_cloud(new, rest_of_host, num_apart, voxel_m)
    if before is not None:
        state.absorbed = after_split(state.absorbed, host_id, before)
        state.joins = without_far(state.joins, host_id, before.id)
        new, left = restored(new, before), without_views_of(left, before)
        text += f"; it was #{before.id} before that was merged"
    state.tracks[host_id] = left
    state.tracks[new.id] = new
    state.decide("split", new.id, text, other_id=host_id)
    return new.id
