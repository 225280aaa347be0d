"""The state of the map: everything that later decisions depend on, with one owner for each part.

Only the modules that `MapperCore` calls change it. Tracks, submaps and the vote book are immutable: a copy of the state
shares them, and published records never change.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING, Any, Self

from hickory_stream.mapping.derived import Derived, RoomVoxels
from hickory_stream.mapping.entities.track import Track, without_views
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.rules.merge_history import (
    Absorbed,
    Joins,
    joins_without,
    views_in,
    views_of,
    without_lost_views,
)
from hickory_stream.mapping.rules.merging import VoteBook
from hickory_stream.mapping.rules.support_graph import SupportGraph
from hickory_stream.records import Decision, View

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.events import SearchLoops
    from hickory_stream.mapping.entities.observed_space import SpaceState
    from hickory_stream.mapping.entities.submaps import Submaps
    from hickory_stream.mapping.rules.splitting import SplitCandidates
    from hickory_stream.records import DecisionKind, DropCause, Loop, PoseGraphRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class PendingFeatures:
    """The keyframe whose features are being computed: candidate best views and track ids, by observation."""

    frame_index: int
    candidates: dict[int, View]
    object_ids: tuple[int | None, ...]


@dataclass(kw_only=True, slots=True, eq=False)
class MapState:
    """The map and its history.

    Attributes:
        submaps: the submaps with their poses, and the observed space.
        tracks: the tracks by id that lie where the odometry has them.
        elsewhere: the tracks by id of submaps that a correction has moved against the open one; their data are in the
            frame of their submap. They come back among `tracks` when they are seen again (`moved_submaps`).
        votes: how often pairs of tracks were segmented together and apart.
        split_candidates: parts of tracks that keyframes segmented apart, by host.
        absorbed: the tracks that were merged into each track, by host.
        joins: the tracks that a correction has brought to each track, by host, so that another one can part them.
        clock_ns: time that has passed in all, in ns, not counting jumps of the stamps.
        stamp_ns: the stamp of the last keyframe; None before the first one and after a jump of the stamps.
        revision: the number of keyframes.
        next_id, next_ticket: the ids of the next track and of the next shape job.
        pending: the keyframe whose features were requested and have not arrived yet.
        sight: (2, 3) the bounds of what the last keyframe saw; None before it.
        judged_ns: the clock when the tracks were judged last, in ns.
        stirred: the tracks to judge in the next keyframe wherever they lie: they, or what is beside them, have changed.
        kept_views: the names of the views whose pixels are kept.
        loops: what searches for loops gave, believed or not, in the order in which they ended.
        searches: the searches for loops that have not ended yet.
        graph: the pose graph as it was solved last; None before the first loop.
        decisions: the decisions since the last publication.
        num_masks, num_features: the number of masks so far, and of those whose features were requested.
        derived: what follows from the rest.
    """

    submaps: Submaps
    tracks: TrackTable = field(default_factory=TrackTable)
    elsewhere: TrackTable = field(default_factory=TrackTable)
    votes: VoteBook = field(default_factory=VoteBook)
    split_candidates: SplitCandidates = field(default_factory=dict)
    absorbed: Absorbed = field(default_factory=dict)
    joins: Joins = field(default_factory=dict)
    clock_ns: int = 0
    stamp_ns: int | None = None
    revision: int = 0
    next_id: int = 1
    next_ticket: int = 1
    pending: PendingFeatures | None = None
    sight: NDArray[np.float32] | None = None
    judged_ns: int = 0
    stirred: set[int] = field(default_factory=set)
    kept_views: set[str] = field(default_factory=set)
    loops: tuple[Loop, ...] = ()
    searches: tuple[SearchLoops, ...] = ()
    graph: PoseGraphRecord | None = None
    decisions: list[Decision] = field(default_factory=list)
    num_masks: int = 0
    num_features: int = 0
    derived: Derived = field(default_factory=Derived)

    def ordered(self) -> list[Track]:
        """Return the tracks in the order of their ids."""
        return self.tracks.ordered()

    def everywhere(self) -> list[Track]:
        """Return all tracks, those elsewhere as well, in the order of their ids."""
        known = {**self.tracks, **self.elsewhere}
        return [known[i] for i in sorted(known)]

    def track(self, track_id: int) -> Track:
        """Return a track, here or elsewhere; raises `KeyError` if there is none of this id."""
        return self.tracks[track_id] if track_id in self.tracks else self.elsewhere[track_id]

    def is_judged(self, track: Track) -> bool:
        """Return whether a track was seen since the last pose jump, so that it can be judged by the observed space."""
        return track.seen_in >= self.submaps.first

    def current_id(self, track_id: int | None) -> int | None:
        """Return the id of a track, or of the one that it was merged into; None if it was dropped."""
        if track_id is None or track_id in self.tracks or track_id in self.elsewhere:
            return track_id
        host_id = self.tracks.host_of(track_id)
        return self.elsewhere.host_of(track_id) if host_id is None else host_id

    def support_graph(self, space: SpaceState | None = None) -> SupportGraph:
        """Return the support graph of `tracks`, which it follows as they change, in a space; None: what is near."""
        return SupportGraph(
            bodies=self.tracks,
            space=self.submaps.space if space is None else space,
        )

    def view_names(self) -> set[str]:
        """Return the names of the views that the tracks have, or that a later split or parting could restore."""
        own = {view.name for track in self.everywhere() for view in track.views}
        return own.union(views_of(self.absorbed), views_in(join for own in self.joins.values() for join in own))

    def advance_clock(self, stamp_ns: int) -> None:
        """Advance the clock to a stamp."""
        if self.stamp_ns is not None:
            self.clock_ns += max(0, stamp_ns - self.stamp_ns)
        self.stamp_ns = stamp_ns

    def decide(
        self,
        kind: DecisionKind,
        object_id: int | None,
        text: str,
        *,
        observation_index: int | None = None,
        other_id: int | None = None,
        cause: DropCause | None = None,
    ) -> None:
        """Record a decision and its reason, for the next publication."""
        decision = Decision(
            kind=kind,
            object_id=object_id,
            text=text,
            observation_index=observation_index,
            other_id=other_id,
            cause=cause,
        )
        self.decisions.append(decision)

    def keep_view(self, name: str) -> None:
        """Note that the pixels of a view are kept from now on."""
        self.kept_views.add(name)
        self.derived.views.ask_for(name)

    def taken_decisions(self) -> tuple[Decision, ...]:
        """Return the decisions since the last publication and clear them."""
        decisions, self.decisions = tuple(self.decisions), []
        return decisions

    def parts(self) -> dict[str, object]:
        """Return the state by the names of its parts; later events do not change it."""
        return {name: _copied(getattr(self, name)) for name in _PARTS}

    @classmethod
    def of_parts(cls, parts: Mapping[str, Any], empty: MapState) -> Self:
        """Return the state from which `parts` were taken; `empty` is the state of a new map.

        Raises:
            ValueError: the state was written by another version.
        """
        expected = {name: getattr(empty, name) for name in _PARTS}
        if parts.keys() != expected.keys():
            raise ValueError(f"a state of {sorted(parts)}; expected {sorted(expected)}")
        # A written state has tuples where there were lists.
        state = cls(
            **{
                name: type(expected[name])(value)
                if isinstance(expected[name], (list, dict, set, TrackTable))
                else value
                for name, value in parts.items()
            }
        )
        state.derived.room = RoomVoxels.of_tracks(state.tracks, state.submaps.first)
        return state

    def going_on_after(self, later: MapState, lost_views: Collection[str]) -> None:
        """Prepare this earlier state for continuing after the run was rewound to it from the `later` one.

        Ids of objects, job tickets and revisions continue from those of `later`, so that no number is used twice.
        The pixels of `lost_views` no longer exist; these views are removed.
        """
        self.next_id = max(self.next_id, later.next_id)
        self.next_ticket = max(self.next_ticket, later.next_ticket)
        self.revision = max(self.revision, later.revision)
        lost = set(lost_views)
        self.kept_views -= lost
        for tracks in (self.tracks, self.elsewhere):
            for track_id, track in tracks.items():
                if not lost.isdisjoint(view.name for view in track.views):
                    tracks[track_id] = without_views(track, lost)
        self.absorbed = without_lost_views(self.absorbed, lost)
        self.joins = joins_without(self.joins, lost)


# Everything but what follows from the rest.
_PARTS = tuple(part.name for part in fields(MapState) if part.name != "derived")


def _copied(part: object) -> object:
    return dict(part) if isinstance(part, TrackTable) else copy(part)
