"""The tracker: data association of a keyframe's observations with tracks; births, votes and splits.

A keyframe's masks may be wrong: points on another track are not fused, and segmenting two tracks as one or as two is
only a vote, which `splitting` and `merging` count.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from hickory_stream.events import Effect, FrameObserved
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.geometry.depth_sensor import information
from hickory_stream.mapping.config import MappingConfig
from hickory_stream.mapping.entities.cloud import Cloud, cloud_of, is_near, share_near, solid_part, without
from hickory_stream.mapping.entities.track import Sighting, Track, grown, new_track, with_cloud
from hickory_stream.mapping.map_state import MapState
from hickory_stream.mapping.rules.association import Match, associate
from hickory_stream.mapping.rules.lifecycle import LifeEvent, counted_ns, first_phase
from hickory_stream.mapping.rules.merge_history import after_split, recalled, restored, without_far, without_views_of
from hickory_stream.mapping.rules.merging import (
    find_pair,
    pair_of,
    pairs_of_groups,
    pairs_that_meet,
    points_on_others,
    why_one,
)
from hickory_stream.mapping.rules.splitting import MIN_VOXELS, SAME_SHARE, SplitCandidate, with_keyframe
from hickory_stream.mapping.steps.endings import unite
from hickory_stream.records import Observation

Associator = Callable[[FrameObserved, Mapping[int, Track]], list[Match]]


# A look counts no longer than this as a vote, so that one under-segmented keyframe never decides.
_LOOK_NS = 500_000_000
# An observation's points are not fused where they lie on another track with at least this many sightings.
_NEIGHBOR_SIGHTINGS = 2
# A part that is thinner, or less than twice that wide, is a rim or a board of its host.
_MIN_SIZE_M = 0.025


class Tracker:
    """Associates the observations of a keyframe with the tracks of a state, and updates these.

    `associator` gives one final match per observation, in their order: all points are fused, tracks are never merged.
    None: association by boxes and points.
    """

    def __init__(self, config: MappingConfig, associator: Associator | None = None) -> None:
        self._config = config
        self._associator = associator

    @property
    def is_external(self) -> bool:
        """Whether an external associator decides which tracks exist."""
        return self._associator is not None

    def track(self, state: MapState, event: FrameObserved) -> list[Sighting]:
        """Assign every observation of a keyframe to a track, or a new one; return the sightings."""
        if self._associator is not None:
            matches = self._associator(event, state.tracks)
        else:
            object_m = self._config.voxels.object_m
            matches = associate(event.observations, state.tracks, object_m, self._config.associate)
        sightings = [self._place(state, event, match) for match in matches]
        self._vote(state, sightings)
        self._note_split_candidates(state, event, sightings)
        return sightings

    def merge_tracks(self, state: MapState, changed: set[int]) -> list[Effect]:
        """Merge the changed tracks with others until no pair has a reason to merge."""
        if self.is_external:
            return []
        effects: list[Effect] = []
        graph, voxel_m, config = state.support_graph(), self._config.voxels.object_m, self._config.merge
        while (pair := find_pair(state.tracks, changed, state.votes, graph, voxel_m, config)) is not None:
            kept_id, gone_id, reason = pair
            effects += unite(state, kept_id, gone_id, reason, self._config)
            changed = (changed - {gone_id}) | {kept_id}
        return effects

    def _place(self, state: MapState, event: FrameObserved, match: Match) -> Sighting:
        observation = event.observations[match.observation_index]
        points, voxel_m = observation.points_world, self._config.voxels.object_m
        weights = information(points, event.world_from_camera, event.depth_law)
        cloud = cloud_of(points, observation.colors, voxel_m, weights, observation.behind)
        if match.track_id is None:
            track_id = self._born(state, event, match, cloud)
            covered: tuple[int, ...] = ()
        else:
            track_id, covered = match.track_id, self._seen_again(state, event, match, cloud)
        return Sighting(
            observation=observation,
            cloud=cloud,
            track_id=track_id,
            is_part=match.is_part,
            lies_on=match.lies_on,
            covered=covered,
        )

    def _born(self, state: MapState, event: FrameObserved, match: Match, cloud: Cloud) -> int:
        observation = event.observations[match.observation_index]
        track_id = state.next_id
        state.tracks[track_id] = new_track(
            track_id,
            cloud,
            phase=first_phase(LifeEvent.BORN),
            stamp_ns=event.stamp_ns,
            clock_ns=state.clock_ns,
            sightings=1,
            submap_id=state.submaps.open_id,
            voxel_m=self._config.voxels.object_m,
        )
        state.next_id += 1
        text = f"mask {observation.box_px}: new; candidates by IoU: {_candidates(match)}"
        state.decide("create", track_id, text, observation_index=observation.index)
        return track_id

    def _seen_again(self, state: MapState, event: FrameObserved, match: Match, cloud: Cloud) -> tuple[int, ...]:
        assert match.track_id is not None
        observation, track = event.observations[match.observation_index], state.tracks[match.track_id]
        how = f"IoU {match.iou:.2f}" if match.lies_on == 0 else f"IoU {match.iou:.2f}, {match.lies_on:.0%} lies on it"
        part = " as a part" if match.is_part else ""
        on_others, covered = points_on_others(cloud, track, self._neighbors(state, track, observation))
        left = f"; {on_others.mean():.0%} of it lies on others and is left out" if on_others.any() else ""
        if _is_cut(event, observation):
            left += "; this frame alone has it as one with another mask, the map does not"
        text = f"mask {observation.box_px}{part}: {how}; candidates by IoU: {_candidates(match)}{left}"
        state.decide("associate", track.id, text, observation_index=observation.index)
        since_ns = counted_ns(state.clock_ns - track.seen_clock_ns)
        own, sightings = without(cloud, on_others), track.sightings + (not match.is_part)
        # An object has a closed outline (Alexe, Deselaers and Ferrari 2012). Of the powers 1, 2, 4 and 8 of the share
        # that is drawn, the fourth tells right tracks best from false ones.
        closed = observation.drawn * observation.drawn
        state.tracks[track.id] = replace(
            grown(track, own, sightings, self._config.voxels.object_m),
            last_seen_ns=event.stamp_ns,
            seen_clock_ns=state.clock_ns,
            seen_through_ns=0,
            seen_in=state.submaps.open_id,
            observed_ns=track.observed_ns + round(closed * closed * since_ns),
        )
        return tuple(covered)

    def _neighbors(self, state: MapState, track: Track, observation: Observation) -> list[Track]:
        # Other established tracks that an observation's points may belong to.
        if self.is_external:
            return []
        near = state.tracks.touching(bounds_of(observation.points_world))
        return [other for other in near if other.id != track.id and other.sightings >= _NEIGHBOR_SIGHTINGS]

    def _vote(self, state: MapState, sightings: list[Sighting]) -> None:
        # Apart: two whole observations whose boxes touch. Together only if not apart, since small objects in contact
        # cover each other's rims. A pair that only the map prior separates is together: the map must not confirm
        # itself.
        whole = [sighting for sighting in sightings if not sighting.is_part]
        grouped = pairs_of_groups([(sighting.observation.group, sighting.track_id) for sighting in whole])
        bounds = [bounds_of(sighting.observation.points_world) for sighting in whole]
        apart = pairs_that_meet(bounds, [sighting.track_id for sighting in whole]) - grouped
        overlap = {pair_of(sighting.track_id, other) for sighting in sightings for other in sighting.covered}
        together = overlap | grouped
        passed_ns = min(state.keyframe_ns, _LOOK_NS)
        votes = state.votes.plus(sorted(apart), apart_ns=passed_ns)
        state.votes = votes.plus(sorted(together - apart), together_ns=passed_ns)

    def _note_split_candidates(self, state: MapState, event: FrameObserved, sightings: list[Sighting]) -> None:
        # A mask is also apart from its track if a mask of another object covers the rest of the track, e.g. a mug whose
        # tray is segmented with the table.
        apart: list[tuple[int, Cloud]] = []
        whole: list[tuple[int, Cloud]] = []
        taken = {track_id for sighting in sightings for track_id in sighting.covered}
        for sighting in sightings:
            is_part = sighting.is_part or (sighting.lies_on > 0 and sighting.track_id in taken)
            (apart if is_part else whole).append((sighting.track_id, sighting.cloud))
        state.split_candidates = with_keyframe(
            state.split_candidates, event.frame_index, min(state.keyframe_ns, _LOOK_NS), apart, whole
        )


def _candidates(match: Match) -> str:
    return ", ".join(f"#{i} {iou:.2f}" for i, iou in match.candidates) or "none"


def _is_cut(event: FrameObserved, observation: Observation) -> bool:
    # The map prior cut it out of a larger instance that the frame alone segments.
    return observation.group > 0 and sum(other.group == observation.group for other in event.observations) > 1


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


def moved_out(state: MapState, sightings: list[Sighting], promoted: Mapping[int, int]) -> list[Sighting]:
    """Return the sightings after splits: masks of a split-off part go to its new track."""
    moved = list(sightings)
    for new_id, host_id in promoted.items():
        for i, sighting in enumerate(sightings):
            lies_on = share_near(sighting.cloud.keys, state.tracks[new_id].cloud) if sighting.is_part else 0.0
            if sighting.track_id == host_id and lies_on >= SAME_SHARE:
                moved[i] = replace(sighting, is_part=False, track_id=new_id)
                text = f"its mask shows what was a part of #{host_id}"
                state.decide("associate", new_id, text, observation_index=sighting.observation.index)
    return moved


def _split_off(
    state: MapState, event: FrameObserved, host_id: int, candidate: SplitCandidate, config: MappingConfig
) -> int | None:
    # None: the candidate is too small, or its support relation makes it a part of the host.
    voxel_m = config.voxels.object_m
    host = state.tracks[host_id]
    rest = without(host.cloud, is_near(host.cloud.keys, candidate.cloud))
    if len(rest.keys) < MIN_VOXELS:
        return None
    cloud = solid_part(candidate.cloud, candidate.sightings)
    new = new_track(
        state.next_id,
        cloud,
        phase=first_phase(LifeEvent.SPLIT_OFF),
        stamp_ns=event.stamp_ns,
        clock_ns=state.clock_ns,
        sightings=candidate.sightings,
        submap_id=state.submaps.open_id,
        observed_ns=candidate.apart_ns,
        voxel_m=voxel_m,
    )
    size = np.sort(2 * new.box.half_extents_m)
    if size[0] < _MIN_SIZE_M or size[1] < 2 * _MIN_SIZE_M:
        return None
    left = with_cloud(host, rest, host.sightings, voxel_m)
    pair = pair_of(host_id, new.id)
    votes = state.votes.plus([pair], apart_ns=candidate.apart_ns, together_ns=candidate.together_ns)
    small, large = (new, left) if new.box.volume_m3 <= left.box.volume_m3 else (left, new)
    near = [track for track in state.tracks.touching(new.bounds) if track.id != host_id]
    graph = state.support_graph()
    is_part = graph.still_part_of(small, large, near)
    if is_part is not None or why_one(left, new, near, votes, graph, voxel_m, config.merge) is not None:
        return None
    state.next_id += 1
    state.votes = votes
    # Its points came from the host: they are in the host's submap.
    new = replace(new, is_promoted=True, submap_id=host.submap_id)
    apart_s, together_s = candidate.apart_ns / 1e9, candidate.together_ns / 1e9
    text = f"seen apart from #{host_id} for {apart_s:.1f} s, as one for {together_s:.1f} s"
    before = recalled(state.absorbed, host_id, cloud, SAME_SHARE)
    if before is None and (before := recalled(state.absorbed, host_id, left.solid, SAME_SHARE)) is not None:
        # The candidate is the original host, and the remaining points are the track that was merged into the host.
        rest_of_host = left.cloud
        # The host keeps its id and sightings, with the candidate's cloud.
        left = replace(with_cloud(host, cloud, candidate.sightings, voxel_m), sightings=host.sightings)
        new = with_cloud(new, rest_of_host, candidate.sightings, voxel_m)
    if before is not None:
        state.absorbed = after_split(state.absorbed, host_id, before)
        state.joins = without_far(state.joins, host_id, before.id)
        new, left = restored(new, before), without_views_of(left, before)
        text += f"; it was #{before.id} before that was merged"
    state.tracks[host_id] = left
    state.tracks[new.id] = new
    state.decide("split", new.id, text, other_id=host_id)
    return new.id
