"""The core of the mapper: every decision about the map, as a function of the events alone.

`MapperCore.handle(event)` is synchronous: no I/O, no clock, no randomness. The same events in the same order give the
same map, to the byte.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, assert_never

import numpy as np

from hickory_stream.events import (
    CancelShape,
    ComputeFeatures,
    DropView,
    Effect,
    Event,
    FeaturesReady,
    FrameObserved,
    KeepView,
    PoseJumped,
    PosesCorrected,
    Publish,
    ShapeFailed,
    ShapeReady,
    SourceEnded,
    TimeJumped,
)
from hickory_stream.geometry import portable
from hickory_stream.geometry.bounds import bounds_of
from hickory_stream.mapping.absorbed import (
    Absorbed,
    after_merge,
    after_split,
    recalled,
    restored,
    views_of,
    without_lost_views,
    without_views_of,
)
from hickory_stream.mapping.associate import Match, associate, is_swollen
from hickory_stream.mapping.cloud import Cloud, cloud_of, is_near, share_near, solid_part, without
from hickory_stream.mapping.existence import Existence, doubted, no_evidence, sighted
from hickory_stream.mapping.lifecycle import aged, next_phase
from hickory_stream.mapping.moved import moved_object
from hickory_stream.mapping.observed_space import (
    as_record,
    floor_change,
    known_no_object,
    share_in,
)
from hickory_stream.mapping.requests import (
    gain_of,
    increase_in_score,
    next_replacements,
    next_requests,
    predicted_s,
    shape_request,
    state_of_request,
    support_height_m,
)
from hickory_stream.mapping.split_candidates import SplitCandidate, SplitCandidates, reassigned, with_keyframe
from hickory_stream.mapping.structure_checks import is_seen_through, points_in_wall, why_structure
from hickory_stream.mapping.submaps import (
    SubmapState,
    first_submap,
    interrupted,
    placed_at,
    record_of,
    torn,
    travelled,
    with_seen,
    with_structure,
)
from hickory_stream.mapping.support_relations import is_inner_part
from hickory_stream.mapping.track import (
    Track,
    as_object,
    grown,
    new_track,
    sketched,
    touching,
    with_cloud,
    without_views,
)
from hickory_stream.mapping.track_merging import (
    VoteBook,
    find_pair,
    foreign_points,
    merge,
    pair_of,
    pairs_of_groups,
    pairs_that_meet,
    why_one,
)
from hickory_stream.mapping.unsupported import attachment_of
from hickory_stream.mapping.views import better, covers_better, score, score_bound, sector_of, view_of
from hickory_stream.records import Decision, MapPrior, MapSnapshot, Phase, Submap, View

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.mapping.mapping_config import MappingConfig
    from hickory_stream.records import DecisionKind, DropCause, MaskFeature, Observation, ObservedSpace, TrackedObject

    Associator = Callable[[FrameObserved, Mapping[int, Track]], list[Match]]


_UNSUPPORTED = "unsupported but for this one, which it touches"
# An observation may be under-segmented with the tracks of the best IoU; those that it barely overlaps do not count.
_MOST_DOUBTED = 4
# Given, or made anew from the rest.
_NOT_STATE = frozenset({"_config", "_associator", "_shown", "_shown_submaps"})


@dataclass(frozen=True, kw_only=True, slots=True)
class _Pending:
    """The keyframe whose features are being computed: candidates for best view by observation, and where it went."""

    frame_index: int
    candidates: dict[int, View]
    object_ids: tuple[int | None, ...]


class MapperCore:
    """Holds the map; only `handle` changes it.

    `associator` says which observation of a keyframe is which track, one match per observation in their order, and it
    has the last word: all points of an observation are its track's, and no two tracks are made one. None: by boxes and
    points, as configured; so does a core that goes on from a state.
    """

    def __init__(self, config: MappingConfig, associator: Associator | None = None) -> None:
        self._config = config
        self._associator = associator
        self._tracks: dict[int, Track] = {}
        self._votes = VoteBook()
        self._split_candidates: SplitCandidates = {}
        self._absorbed: Absorbed = {}
        self._submaps = first_submap(config.lattice.space_m)
        self._clock_ns = 0
        self._stamp_ns: int | None = None
        self._revision = 0
        self._next_id = 1
        self._next_ticket = 1
        self._pending: _Pending | None = None
        self._kept_views: set[str] = set()
        self._decisions: list[Decision] = []
        self._shown: dict[int, tuple[Track, NDArray[np.float64], TrackedObject]] = {}
        self._shown_submaps: dict[int, tuple[SubmapState, Submap]] = {}
        self._num_masks = 0
        self._num_features = 0

    def handle(self, event: Event) -> list[Effect]:
        """Return what is to be done after an event.

        Raises:
            ValueError: the event does not fit, e.g. features of a keyframe that is not pending.
        """
        match event:
            case FrameObserved():
                return self._frame_observed(event)
            case FeaturesReady():
                return self._features_ready(event)
            case ShapeReady() | ShapeFailed():
                return self._shape_ended(event)
            case TimeJumped():
                self._stamp_ns = None
                self._submaps = interrupted(self._submaps)
                self._decide("time_jump", None, f"{event.kind}: stamps jumped from {event.from_ns} to {event.to_ns}")
                return []
            case PoseJumped():
                return self._pose_jumped(event)
            case PosesCorrected():
                return self._poses_corrected(event)
            case SourceEnded():
                return self._source_ended()
            case _:
                assert_never(event)

    def state(self) -> dict[str, object]:
        """Return all that decides what comes next, by name; later events do not change it."""
        return {name: copy(value) for name, value in vars(self).items() if name not in _NOT_STATE}

    @classmethod
    def from_state(cls, config: MappingConfig, state: Mapping[str, Any]) -> MapperCore:
        """Return a core that goes on from what `state` returned.

        Raises:
            ValueError: the state is that of another version.
        """
        core = cls(config)
        if state.keys() != core.state().keys():
            raise ValueError(f"a state of {sorted(state)}; expected {sorted(core.state())}")
        for name, value in state.items():
            empty = getattr(core, name)
            # A written state has tuples where there were lists.
            setattr(core, name, type(empty)(value) if isinstance(empty, (list, dict, set)) else value)
        return core

    def view_names(self) -> set[str]:
        """Return the names of the views that the map has, or would have again after a split."""
        own = {view.name for track in self._tracks.values() for view in track.views}
        return own.union(views_of(self._absorbed))

    def going_on_after(self, later: MapperCore, lost_views: Collection[str]) -> MapperCore:
        """Return a core with this one's map that goes on after a later one was left.

        Objects, jobs and revisions are numbered on from the later one's, so that each number means one thing.
        `lost_views` have no pixels any more: nothing can be made of them.
        """
        core = MapperCore.from_state(self._config, self.state())
        core._next_id = max(self._next_id, later._next_id)
        core._next_ticket = max(self._next_ticket, later._next_ticket)
        core._revision = max(self._revision, later._revision)
        core._kept_views -= set(lost_views)
        lost = set(lost_views)
        for track_id, track in self._tracks.items():
            if not lost.isdisjoint(view.name for view in track.views):
                core._tracks[track_id] = without_views(track, lost)
        core._absorbed = without_lost_views(core._absorbed, lost)
        return core

    def snapshot(self) -> MapSnapshot:
        """Return the map as it is now."""
        objects = []
        for track_id in sorted(self._tracks):
            track = self._tracks[track_id]
            place = self._submaps.world_from(track.submap_id)
            cached = self._shown.get(track_id)
            if cached is None or cached[0] is not track or cached[1] is not place:
                cached = (track, place, _in_world(as_object(track), place))
                self._shown[track_id] = cached
            objects.append(cached[2])
        return MapSnapshot(
            revision=self._revision,
            stamp_ns=self._stamp_ns or 0,
            submaps=tuple(self._submap(state) for state in self._submaps.states),
            objects=tuple(objects),
        )

    def prior(self) -> MapPrior | None:
        """Return what perception knows beforehand, as the odometry has it, whatever was corrected; None: no keyframe.

        The space and the objects that were seen since the odometry last jumped, wherever submaps ended.
        """
        if self._revision == 0:
            return None
        return MapPrior(
            space=self._observed_space(), objects=self._known_objects(), points_m=self._config.lattice.points_m
        )

    def _observed_space(self) -> ObservedSpace:
        is_one = self._submaps.first == self._submaps.open_id
        return self._submap(self._submaps.states[-1]).observed_space if is_one else as_record(self._submaps.space)

    def _known_objects(self) -> tuple[TrackedObject, ...]:
        known = []
        for track_id, track in sorted(self._tracks.items()):
            if self._is_judged(track):
                shown = self._shown.get(track_id)
                is_there = shown is not None and shown[0] is track and np.array_equal(shown[1], np.eye(4))
                known.append(shown[2] if shown is not None and is_there else as_object(track))
        return tuple(known)

    def _submap(self, state: SubmapState) -> Submap:
        cached = self._shown_submaps.get(state.id)
        if cached is None or cached[0] is not state:
            cached = self._shown_submaps[state.id] = (state, record_of(state))
        return cached[1]

    # ---- where things lie --------------------------------------------------------------------------------------------

    def _pose_jumped(self, event: PoseJumped) -> list[Effect]:
        """Close the submap. Poses go on in its world, so that what was seen in it is known again when it is seen.

        The space is judged anew, and until an object is seen again it is judged by nothing: a few centimetres, by
        which the jump may be wrong, are enough to look through an object, or to put it in a wall.
        """
        distance_m = portable.norm(event.after_from_before[:3, 3])
        self._settle()
        self._submaps = torn(self._submaps)
        self._split_candidates = {}
        text = f"the odometry jumped by {distance_m:.2f} m: submap {self._submaps.open_id} begins"
        self._decide("pose_jump", None, text)
        return []

    def _poses_corrected(self, event: PosesCorrected) -> list[Effect]:
        """Place submaps anew: everything is kept as the odometry had it, and handed out where it lies."""
        self._submaps = placed_at(self._submaps, dict(zip(event.submap_ids, event.world_from_submap, strict=True)))
        text = f"submaps {', '.join(map(str, event.submap_ids)) or 'none'} were placed anew"
        self._decide("pose_correction", None, text)
        # The decision is published with the next keyframe.
        return [Publish(snapshot=self.snapshot(), decisions=())]

    def _settle(self) -> None:
        """Remove the points of tracks that lie in structure, before the observed space is reset."""
        for track_id in sorted(self._tracks):
            if self._is_judged(self._tracks[track_id]):
                self._tracks[track_id] = self._without_wall(self._tracks[track_id])

    def _is_judged(self, track: Track) -> bool:
        """Return whether a track was seen since the last pose jump, so that it can be judged by the observed space."""
        return track.seen_in >= self._submaps.first

    # ---- one keyframe ------------------------------------------------------------------------------------------------

    def _frame_observed(self, event: FrameObserved) -> list[Effect]:
        if self._pending is not None:
            raise ValueError(
                f"frame {event.frame_index} came while features of {self._pending.frame_index} are pending"
            )
        self._revision += 1
        self._advance_clock(event.stamp_ns)
        self._submaps = travelled(self._submaps, event.world_from_camera[:3, 3], self._config.submaps)
        self._decisions += [
            Decision(kind="reject", object_id=None, text=f"mask {r.box_px}: {r.reason}") for r in event.rejected
        ]

        matches = self._associated(event)
        self._doubt(event, matches)
        clouds = [self._cloud_of(event.observations[match.observation_index]) for match in matches]
        placed = [self._place(event, match, seen) for match, seen in zip(matches, clouds, strict=True)]
        homes, covered = [home for home, _ in placed], [others for _, others in placed]
        self._vote(event, matches, homes, covered)
        self._note_split_candidates(event, matches, homes, clouds, covered)
        promoted = self._split_tracks(event, set(homes))
        matches, homes = self._moved_out(matches, homes, clouds, promoted)
        effects = [*self._merge_tracks({*homes, *promoted, *promoted.values()}), *self._age(event)]
        changed = floor_change(self._submaps.space, event.space.floor_z_m)
        if changed is not None:
            self._decide("floor", None, changed)
        self._submaps = with_seen(self._submaps, event.space)

        candidates, keeps = self._propose_views(event, matches, homes)
        object_ids = tuple(self._final_id(home) for home in homes)
        self._num_masks += len(event.observations)
        effects += keeps
        if candidates:
            self._num_features += len(candidates)
            self._pending = _Pending(frame_index=event.frame_index, candidates=candidates, object_ids=object_ids)
            wanted = tuple(sorted(candidates))
            return [*effects, ComputeFeatures(frame_index=event.frame_index, observation_indices=wanted)]
        return [*effects, *self._conclude(object_ids)]

    def _features_ready(self, event: FeaturesReady) -> list[Effect]:
        pending = self._pending
        if pending is None or pending.frame_index != event.frame_index:
            raise ValueError(f"features of frame {event.frame_index} were not asked for")
        self._pending = None
        effects: list[Effect] = []
        for feature in sorted(event.features, key=lambda f: f.observation_index):
            view = self._judge(pending.candidates[feature.observation_index], feature)
            if view is not None and view.name not in self._kept_views:
                self._kept_views.add(view.name)
                effects.append(KeepView(view=view, observation_index=feature.observation_index))
        return [*effects, *self._conclude(pending.object_ids)]

    def _conclude(self, object_ids: tuple[int | None, ...]) -> list[Effect]:
        """Return the requests, the drops and the publication that end every keyframe."""
        effects: list[Effect] = [*self._request_shapes(is_final=False), *self._drop_views()]
        decisions, self._decisions = tuple(self._decisions), []
        return [
            *effects,
            Publish(snapshot=self.snapshot(), decisions=decisions, object_ids=object_ids, metrics=self._metrics()),
        ]

    # ---- the steps of a keyframe -------------------------------------------------------------------------------------

    def _advance_clock(self, stamp_ns: int) -> None:
        if self._stamp_ns is not None:
            self._clock_ns += max(0, stamp_ns - self._stamp_ns)
        self._stamp_ns = stamp_ns

    def _associated(self, event: FrameObserved) -> list[Match]:
        if self._associator is not None:
            return self._associator(event, self._tracks)
        return associate(event.observations, self._tracks, self._config.lattice.points_m, self._config.associate)

    def _cloud_of(self, observation: Observation) -> Cloud:
        return cloud_of(observation.points_world, observation.colors, self._config.lattice.points_m)

    def _place(self, event: FrameObserved, match: Match, seen: Cloud) -> tuple[int, list[int]]:
        """Fuse an observation into its track, or make a new one; return its id, and the other tracks that it covers."""
        observation = event.observations[match.observation_index]
        others = ", ".join(f"#{i} {iou:.2f}" for i, iou in match.candidates) or "none"
        if match.track_id is None:
            found = self._sighted(no_evidence(), event, observation)
            track_id = self._next_id
            self._tracks[track_id] = self._new_track(event, seen, 1, found)
            self._next_id += 1
            text = f"mask {observation.box_px}: new; candidates by IoU: {others}"
            self._decide("create", track_id, text, observation_index=observation.index)
            return track_id, []
        track = self._tracks[match.track_id]
        how = f"IoU {match.iou:.2f}" if match.lies_on == 0 else f"IoU {match.iou:.2f}, {match.lies_on:.0%} lies on it"
        part = " as a part" if match.is_part else ""
        foreign, covered = foreign_points(seen, track, self._neighbors(track, observation), self._config.merge)
        left = f"; {foreign.mean():.0%} of it lies on others and is left out" if foreign.any() else ""
        if _is_cut(event, observation):
            left += "; this frame alone has it as one with another mask, the map does not"
        text = f"mask {observation.box_px}{part}: {how}; candidates by IoU: {others}{left}"
        self._decide("associate", track.id, text, observation_index=observation.index)
        track = replace(
            track,
            last_seen_ns=event.stamp_ns,
            seen_clock_ns=self._clock_ns,
            seen_through=0,
            seen_in=self._submaps.open_id,
        )
        if foreign.mean() < 0.9:
            track = grown(
                track, without(seen, foreign), track.sightings + (not match.is_part), self._config.lattice.points_m
            )
            if not match.is_part:
                track = replace(track, existence=self._sighted(track.existence, event, observation))
        self._tracks[track.id] = track
        return track.id, covered

    def _sighted(self, known: Existence, event: FrameObserved, observation: Observation) -> Existence:
        return sighted(known, observation, event.world_from_camera[:3, 3], self._config.existence)

    def _new_track(self, event: FrameObserved, cloud: Cloud, sightings: int, existence: Existence) -> Track:
        """Return a track that was first seen now; it has the next id, which is not taken yet."""
        return new_track(
            self._next_id,
            cloud,
            stamp_ns=event.stamp_ns,
            clock_ns=self._clock_ns,
            sightings=sightings,
            submap_id=self._submaps.open_id,
            existence=existence,
            voxel_m=self._config.lattice.points_m,
        )

    def _note_split_candidates(
        self,
        event: FrameObserved,
        matches: list[Match],
        homes: Sequence[int],
        clouds: Sequence[Cloud],
        covered: Sequence[list[int]],
    ) -> None:
        """Count for split candidates the keyframe's masks: those apart from their track, and those of the whole track.

        A mask is also apart from its track where a mask of another object covers the rest: a mug, where the tray under
        it is segmented together with the table.
        """
        apart: list[tuple[int, Cloud]] = []
        whole: list[tuple[int, Cloud]] = []
        taken = {track_id for others in covered for track_id in others}
        for match, home, cloud in zip(matches, homes, clouds, strict=True):
            is_part = match.is_part or (match.lies_on > 0 and home in taken)
            (apart if is_part else whole).append((home, cloud))
        self._split_candidates = with_keyframe(
            self._split_candidates, event.frame_index, apart, whole, self._config.split
        )

    def _split_tracks(self, event: FrameObserved, hosts: set[int]) -> dict[int, int]:
        """Split off the candidates that are objects; return the ids of their hosts by the new ids."""
        promoted: dict[int, int] = {}
        for host_id in sorted(hosts & self._split_candidates.keys()):
            for candidate in self._split_candidates[host_id]:
                if not candidate.is_object(self._config.split):
                    continue
                if (new := self._split_off(event, host_id, candidate)) is not None:
                    promoted[new] = host_id
                    left = (other for other in self._split_candidates[host_id] if other is not candidate)
                    self._split_candidates[host_id] = tuple(left)
        return promoted

    def _moved_out(
        self, matches: list[Match], homes: Sequence[int], clouds: Sequence[Cloud], promoted: Mapping[int, int]
    ) -> tuple[list[Match], list[int]]:
        """Return matches and homes after splits: the mask that showed a split-off object is its first view."""
        moved, new_homes = list(matches), list(homes)
        for new_id, host_id in promoted.items():
            for i, (match, home) in enumerate(zip(matches, homes, strict=True)):
                lies_on = share_near(clouds[i].keys, self._tracks[new_id].cloud) if match.is_part else 0.0
                if home == host_id and lies_on >= self._config.split.same_share:
                    moved[i], new_homes[i] = replace(match, is_part=False), new_id
                    text = f"its mask shows what was a part of #{host_id}"
                    self._decide("associate", new_id, text, observation_index=match.observation_index)
        return moved, new_homes

    def _split_off(self, event: FrameObserved, host_id: int, candidate: SplitCandidate) -> int | None:
        """Make a track of a candidate and remove its points from the host; None where its support says it belongs."""
        host = self._tracks[host_id]
        rest = without(host.cloud, is_near(host.cloud.keys, candidate.cloud))
        if len(rest.keys) < self._config.split.min_voxels:
            return None
        num_apart = len(candidate.frames)
        cloud = solid_part(candidate.cloud, num_apart)
        # The keyframes that segmented it apart are its sightings: it is confirmed from the start.
        known = Existence(evidence=float(num_apart), places=event.world_from_camera[None, :3, 3])
        new = self._new_track(event, cloud, num_apart, known)
        size = np.sort(2 * new.box.half_extents_m)
        if size[0] < self._config.split.min_size_m or size[1] < 2 * self._config.split.min_size_m:
            return None
        left = with_cloud(host, rest, host.sightings, self._config.lattice.points_m)
        pair = pair_of(host_id, new.id)
        votes = self._votes.plus([pair], apart=num_apart).plus([pair], together=candidate.together)
        small, large = (new, left) if new.box.volume_m3 <= left.box.volume_m3 else (left, new)
        near = touching(new.bounds, [self._tracks[i] for i in sorted(self._tracks) if i != host_id])
        belongs = is_inner_part(small, large, near, inside=0.55, max_volume=0.5, was_one=True)
        if belongs or why_one(left, new, near, votes, self._config.merge) is not None:
            return None
        self._next_id += 1
        self._votes = votes
        # Its points were the host's, so that they lie in the same submap.
        new = replace(new, is_promoted=True, submap_id=host.submap_id)
        text = f"seen apart from #{host_id} in {num_apart} keyframes, as one in {candidate.together}"
        same_share, voxel_m = self._config.split.same_share, self._config.lattice.points_m
        before = recalled(self._absorbed, host_id, cloud, same_share)
        if before is None and (before := recalled(self._absorbed, host_id, left.solid, same_share)) is not None:
            # The part is what the host was before, and the rest of it is what was merged into it.
            rest_of_host = left.cloud
            left, new = with_cloud(host, cloud, num_apart, voxel_m), with_cloud(new, rest_of_host, num_apart, voxel_m)
        if before is not None:
            self._absorbed = after_split(self._absorbed, host_id, before)
            new, left = restored(new, before), without_views_of(left, before)
            text += f"; it was #{before.id} before that was merged"
        self._tracks[host_id] = left
        self._tracks[new.id] = new
        self._decide("split", new.id, text, other_id=host_id)
        return new.id

    def _doubt(self, event: FrameObserved, matches: list[Match]) -> None:
        """Count doubts: under-segmented observations of each established track; a match of its own resets them."""
        seen = {match.track_id for match in matches}
        for match in matches:
            observation = event.observations[match.observation_index]
            for track_id, _ in match.candidates[:_MOST_DOUBTED]:
                track = self._tracks[track_id]
                if track_id not in seen and is_swollen(observation, track, self._config.associate):
                    self._tracks[track_id] = replace(track, doubts=track.doubts + 1)
        for track_id in sorted(i for i in seen if i is not None):
            self._tracks[track_id] = replace(self._tracks[track_id], doubts=0)

    def _neighbors(self, track: Track, observation: Observation) -> list[Track]:
        """Return the other confirmed tracks whose boxes reach into an observation's, and may have points of it."""
        if self._associator is not None:
            return []
        ordered = [self._tracks[i] for i in sorted(self._tracks)]
        near = touching(bounds_of(observation.points_world), ordered)
        return [other for other in near if other.id != track.id and other.sightings >= 2]

    def _vote(
        self, event: FrameObserved, matches: list[Match], homes: Sequence[int], covered: Sequence[list[int]]
    ) -> None:
        """Count the votes of this keyframe: pairs of tracks that it segments apart or, otherwise, together, each once.

        Apart: two whole observations with boxes that meet. Small things that touch cover each other's rims, so that
        only a pair that is not seen apart can be seen together. What only the map holds apart was seen together: a vote
        is what the frame by itself says, or the map would prove itself right.
        """
        found = [event.observations[match.observation_index] for match in matches]
        whole = [(o, home) for o, match, home in zip(found, matches, homes, strict=True) if not match.is_part]
        told = pairs_of_groups([(observation.group, home) for observation, home in whole])
        bounds = [bounds_of(observation.points_world) for observation, _ in whole]
        apart = pairs_that_meet(bounds, [home for _, home in whole]) - told
        overlap = {pair_of(home, other) for home, others in zip(homes, covered, strict=True) for other in others}
        together = overlap | told
        self._votes = self._votes.plus(sorted(apart), apart=1).plus(sorted(together - apart), together=1)

    def _merge_tracks(self, changed: set[int]) -> list[Effect]:
        if self._associator is not None:
            return []
        effects: list[Effect] = []
        while (pair := find_pair(self._tracks, changed, self._votes, self._config.merge)) is not None:
            kept_id, gone_id, reason = pair
            effects += self._unite(kept_id, gone_id, reason)
            changed = (changed - {gone_id}) | {kept_id}
        return effects

    def _unite(self, kept_id: int, gone_id: int, reason: str) -> list[Effect]:
        kept, gone = self._tracks[kept_id], self._tracks.pop(gone_id)
        self._tracks[kept_id] = merge(kept, gone, self._config.lattice.points_m, self._config.views)
        self._votes = self._votes.merged(kept_id, gone_id)
        self._split_candidates = reassigned(self._split_candidates, kept_id, gone_id)
        self._absorbed = after_merge(self._absorbed, kept_id, gone)
        self._shown.pop(gone_id, None)
        self._decide("merge", kept_id, f"#{gone_id} is the same: {reason}", other_id=gone_id)
        open_ticket = gone.shape_state.open_ticket
        return [] if open_ticket is None else [CancelShape(ticket=open_ticket)]

    def _age(self, event: FrameObserved) -> list[Effect]:
        effects: list[Effect] = []
        no_object = known_no_object(self._submaps.space)
        for track_id in sorted(self._tracks):
            track = self._tracks[track_id]
            is_judged = self._is_judged(track)
            reason = why_structure(track, self._submaps.space, self._clock_ns, self._config) if is_judged else None
            if reason is not None:
                self._submaps = with_structure(self._submaps, track.solid.points)
                no_object = known_no_object(self._submaps.space)
                effects += self._drop_track(track, "structure", reason)
                continue
            lies_in = share_in(no_object, track.solid.points, self._submaps.space.voxel_m) if is_judged else 0.0
            if lies_in > self._config.lifecycle.structure_share:
                effects += self._drop_track(track, "in structure", "a piece of what was found to be structure")
                continue
            is_out_of_sight = is_judged and track.seen_clock_ns != self._clock_ns
            if is_out_of_sight and is_seen_through(track, event.space.free_keys, self._config):
                track = replace(track, seen_through=track.seen_through + 1, existence=doubted(track.existence))
            phase = next_phase(track, self._clock_ns, self._config.lifecycle)
            if phase is None:
                effects += self._drop_track(track, "looked through" if track.seen_through else "never confirmed")
                continue
            if is_judged and phase is Phase.DORMANT and track.phase is Phase.ACTIVE:
                if (host := self._attachment_of(track)) is not None:
                    effects += self._unite(host.id, track_id, _UNSUPPORTED)
                    continue
                track = self._without_wall(track)
            if phase is not track.phase:
                self._decide("phase", track_id, f"{track.phase} -> {phase} after {track.sightings} sightings")
            self._tracks[track_id] = sketched(aged(track, phase), self._config.track)
        return effects

    def _attachment_of(self, track: Track) -> Track | None:
        """Return the track that an unsupported track is attached to; None if it is supported, or near nothing."""
        if self._associator is not None:
            return None
        others = (o for o in self._tracks.values() if o.phase is not Phase.TENTATIVE and self._is_judged(o))
        return attachment_of(track, others, self._submaps.space, self._config.unsupported)

    def _without_wall(self, track: Track) -> Track:
        """Return a track without its points in structure, if these are more than a narrow strip along a wall."""
        in_wall = points_in_wall(track, self._submaps.space, self._config)
        if in_wall is None:
            return track
        self._decide("trim", track.id, f"{in_wall.mean():.0%} of its points are those of a wall")
        return with_cloud(track, without(track.cloud, in_wall), track.sightings, self._config.lattice.points_m)

    def _drop_track(self, track: Track, cause: DropCause, reason: str | None = None) -> list[Effect]:
        del self._tracks[track.id]
        self._shown.pop(track.id, None)
        self._votes = self._votes.without(track.id)
        self._split_candidates.pop(track.id, None)
        self._absorbed.pop(track.id, None)
        self._decide("drop", track.id, f"{reason or cause}, after {track.sightings} sightings", cause=cause)
        ticket = track.shape_state.open_ticket
        return [] if ticket is None else [CancelShape(ticket=ticket)]

    # ---- views -------------------------------------------------------------------------------------------------------

    def _propose_views(
        self, event: FrameObserved, matches: list[Match], homes: Sequence[int]
    ) -> tuple[dict[int, View], list[Effect]]:
        """Return the views whose bound beats the best view, by observation, and what is kept for its direction."""
        candidates: dict[int, View] = {}
        keeps: list[Effect] = []
        for match, home in zip(matches, homes, strict=True):
            track_id = self._final_id(home)
            if track_id is None or match.is_part:
                continue
            observation, track = event.observations[match.observation_index], self._tracks[track_id]
            view = view_of(event, observation, track_id)
            best = track.best_view
            bound = score_bound(view, self._config.views)
            if best is None or best.score is None or bound > best.score:
                candidates[observation.index] = view
            else:
                self._decide("view", track_id, f"frame {event.frame_index}: bound {bound:.3f} <= best {best.score:.3f}")
            sector = sector_of(view, track.box.center)
            coverage = dict(track.coverage)
            if covers_better(view, coverage.get(sector), self._config.views):
                coverage[sector] = view
                self._tracks[track_id] = replace(track, coverage=tuple(sorted(coverage.items(), key=lambda kv: kv[0])))
                self._kept_views.add(view.name)
                keeps.append(KeepView(view=view, observation_index=observation.index))
        return candidates, keeps

    def _judge(self, candidate: View, feature: MaskFeature) -> View | None:
        """Make a candidate the best view if its score wins; return it then."""
        track_id = self._final_id(candidate.object_id)
        if track_id is None:
            return None
        track = self._tracks[track_id]
        value = score(candidate, feature.variance, self._config.views)
        view = replace(candidate, object_id=track_id, score=value, variance=feature.variance, feature=feature.pooled)
        coverage = tuple((sector, view if kept.name == view.name else kept) for sector, kept in track.coverage)
        wins = better(track.best_view, view) is view
        before = "no view before" if track.best_view is None else f"best was {track.best_view.score or 0.0:.3f}"
        self._decide(
            "view",
            track_id,
            f"frame {view.frame_index}: {self._config.views.strategy} {value:.3f} "
            f"(sigma^2 {feature.variance:.3f}, area {view.r_area:.4f}, depth {view.r_depth:.2f}), {before}: "
            + ("best" if wins else "kept out"),
        )
        self._tracks[track_id] = replace(track, coverage=coverage, best_view=view if wins else track.best_view)
        return view if wins else None

    def _drop_views(self) -> list[Effect]:
        used = self.view_names()
        gone = sorted(self._kept_views - used)
        self._kept_views &= used
        return [DropView(name=name) for name in gone]

    # ---- shapes ------------------------------------------------------------------------------------------------------

    def _request_shapes(self, *, is_final: bool) -> list[Effect]:
        config = self._config.requests
        num_open = sum(track.shape_state.open_ticket is not None for track in self._tracks.values())
        effects: list[Effect] = []
        replaced = [] if is_final else next_replacements(self._tracks, self._clock_ns, config)
        wanted = next_requests(self._tracks, num_open, self._clock_ns, is_final=is_final, config=config)
        for track_id in (*replaced, *wanted):
            track = self._tracks[track_id]
            if (gone := track.shape_state.open_ticket) is not None:
                effects.append(CancelShape(ticket=gone))
                self._decide("shape", track_id, f"job {gone} is replaced: S grew by {increase_in_score(track):.3f}")
            ticket = self._next_ticket
            self._next_ticket += 1
            support_z_m = support_height_m(track, self._tracks.values(), self._submaps.space.floor_z_m)
            due_ns = (self._stamp_ns or 0) + int(config.latency_s * 1e9)
            request = shape_request(track, ticket=ticket, support_z_m=support_z_m, due_ns=due_ns)
            effects.append(request)
            self._decide(
                "shape",
                track_id,
                f"job {ticket} asked for: S {increase_in_score(track):+.3f} in {predicted_s(track, config):.1f} s, "
                f"new {gain_of(track):.2f}, {len(request.views)} views",
            )
            state = state_of_request(track, ticket, self._clock_ns, is_replacement=gone is not None)
            self._tracks[track_id] = replace(track, shape_state=state)
        return effects

    def _shape_ended(self, event: ShapeReady | ShapeFailed) -> list[Effect]:
        track = self._tracks.get(event.object_id)
        if track is None or track.shape_state.open_ticket != event.ticket:
            self._decide("shape", event.object_id, f"job {event.ticket} ended, but is no longer wanted")
            return []
        state = replace(track.shape_state, open_ticket=None)
        if isinstance(event, ShapeReady):
            self._decide("shape", track.id, f"job {event.ticket}: {len(event.shape.fitted)} superquadrics")
            self._tracks[track.id] = replace(track, shape=event.shape, shape_state=replace(state, failures=0))
        else:
            self._decide("shape", track.id, f"job {event.ticket} gave no shape: {event.reason}")
            self._tracks[track.id] = replace(track, shape_state=replace(state, failures=state.failures + 1))
        return []

    # ---- the end -----------------------------------------------------------------------------------------------------

    def _source_ended(self) -> list[Effect]:
        effects: list[Effect] = []
        self._settle()
        for track_id in sorted(self._tracks):
            track = self._tracks[track_id]
            if track.phase is Phase.TENTATIVE:
                effects += self._drop_track(track, "never confirmed")
            elif self._is_judged(track) and (host := self._attachment_of(track)) is not None:
                effects += self._unite(host.id, track_id, _UNSUPPORTED)
        self._absorbed = {}  # nothing splits any more
        effects += [*self._request_shapes(is_final=True), *self._drop_views()]
        decisions, self._decisions = tuple(self._decisions), []
        return [*effects, Publish(snapshot=self.snapshot(), decisions=decisions, metrics=self._metrics())]

    def _final_id(self, track_id: int | None) -> int | None:
        """Return the id of a track, or of the one that it was merged into; None if it was dropped."""
        if track_id is None or track_id in self._tracks:
            return track_id
        return next((i for i in sorted(self._tracks) if track_id in self._tracks[i].merged_ids), None)

    def _decide(
        self,
        kind: DecisionKind,
        object_id: int | None,
        text: str,
        *,
        observation_index: int | None = None,
        other_id: int | None = None,
        cause: DropCause | None = None,
    ) -> None:
        decision = Decision(
            kind=kind,
            object_id=object_id,
            text=text,
            observation_index=observation_index,
            other_id=other_id,
            cause=cause,
        )
        self._decisions.append(decision)

    def _metrics(self) -> tuple[tuple[str, float], ...]:
        counts = [(f"core/{phase}", float(sum(t.phase is phase for t in self._tracks.values()))) for phase in Phase]
        scores = [
            (f"score/{track.id}", track.best_view.score)
            for _, track in sorted(self._tracks.items())
            if track.best_view is not None and track.best_view.score is not None
        ]
        saved = 1.0 - self._num_features / self._num_masks if self._num_masks else 0.0
        return (*counts, ("core/features_saved", saved), *scores)


def _is_cut(event: FrameObserved, observation: Observation) -> bool:
    """Return whether the frame by itself has an observation as one with another, from which the map's prior cut it."""
    return observation.group > 0 and sum(other.group == observation.group for other in event.observations) > 1


def _in_world(item: TrackedObject, world_from_submap: NDArray[np.float64]) -> TrackedObject:
    """Return an object where its submap lies: itself, to the byte, where that was not corrected."""
    return item if np.array_equal(world_from_submap, np.eye(4)) else moved_object(item, world_from_submap)
