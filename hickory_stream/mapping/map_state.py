"""The state of the map: everything that later decisions depend on.

Only the modules that `MapperCore` calls change it. Tracks, submaps and votes are immutable, so copies share them.
"""

from collections.abc import Collection, Mapping
from copy import copy
from dataclasses import dataclass, field, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from hickory_stream.events import SearchLoops
from hickory_stream.mapping.derived import Derived
from hickory_stream.mapping.entities.observed_space import SpaceState
from hickory_stream.mapping.entities.submaps import Submaps
from hickory_stream.mapping.entities.track import Track, without_views
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.rules.merge_history import Absorbed, Joins, joins_without, views_in, without_lost_views
from hickory_stream.mapping.rules.merging import VoteBook
from hickory_stream.mapping.rules.splitting import SplitCandidates
from hickory_stream.mapping.rules.support_graph import SupportGraph
from hickory_stream.records import Decision, DecisionKind, DropCause, Loop, PoseGraphRecord, View


@dataclass(frozen=True, kw_only=True, slots=True)
class PendingFeatures:
    """The keyframe whose features are being computed: candidate best views and track ids, by observation."""

    frame_index: int
    candidates: dict[int, View]
    object_ids: tuple[int | None, ...]


@dataclass(kw_only=True, slots=True, eq=False)
class MapState:
    """The map and its history."""

    submaps: Submaps
    #: by id, the tracks that lie where the odometry has them
    tracks: TrackTable = field(default_factory=TrackTable)
    #: by id, tracks of submaps that a correction has moved, in their submap's frame (`moved_submaps`)
    elsewhere: TrackTable = field(default_factory=TrackTable)
    votes: VoteBook = field(default_factory=VoteBook)
    split_candidates: SplitCandidates = field(default_factory=dict)
    #: the tracks that were merged into each track, by host
    absorbed: Absorbed = field(default_factory=dict)
    #: the tracks that a correction has brought to each track, by host, for a later unmerge
    joins: Joins = field(default_factory=dict)
    #: time that has passed in all, without jumps of the stamps
    clock_ns: int = 0
    #: time between the last two keyframes
    keyframe_ns: int = 0
    #: stamp of the last keyframe; None before it and after a jump of the stamps
    stamp_ns: int | None = None
    revision: int = 0
    next_id: int = 1
    next_ticket: int = 1
    #: the keyframe whose features were requested and have not arrived
    pending: PendingFeatures | None = None
    #: bounds (2, 3) of the last keyframe's view
    sight: NDArray[np.float32] | None = None
    #: the clock at the last judgement of the tracks
    judged_ns: int = 0
    #: tracks to judge in the next keyframe wherever they lie: they or their neighbours have changed
    stirred: set[int] = field(default_factory=set)
    kept_views: set[str] = field(default_factory=set)
    #: results of the searches for loops, believed or not, in order
    loops: tuple[Loop, ...] = ()
    searches: tuple[SearchLoops, ...] = ()
    #: the last solution of the pose graph; None before the first loop
    graph: PoseGraphRecord | None = None
    decisions: list[Decision] = field(default_factory=list)
    num_masks: int = 0
    num_features: int = 0
    derived: Derived = field(default_factory=Derived)

    def everywhere(self) -> list[Track]:
        """Return all tracks, here and elsewhere, in the order of their ids."""
        known = {**self.tracks, **self.elsewhere}
        return [known[i] for i in sorted(known)]

    def track(self, track_id: int) -> Track:
        """Return a track, here or elsewhere; raises `KeyError` if there is none of this id."""
        return self.tracks[track_id] if track_id in self.tracks else self.elsewhere[track_id]

    def is_judged(self, track: Track) -> bool:
        """Return whether a track was seen since the last pose jump, so that the observed space can judge it."""
        return track.seen_in >= self.submaps.first

    def current_id(self, track_id: int | None) -> int | None:
        """Return the id of a track, or of the track it was merged into; None if it was dropped."""
        if track_id is None or track_id in self.tracks or track_id in self.elsewhere:
            return track_id
        host_id = self.tracks.host_of(track_id)
        return self.elsewhere.host_of(track_id) if host_id is None else host_id

    def support_graph(self, space: SpaceState | None = None) -> SupportGraph:
        """Return the support graph of `tracks`, updated as they change, in a space; None: the submaps' space."""
        return SupportGraph(
            bodies=self.tracks,
            space=self.submaps.space if space is None else space,
        )

    def view_names(self) -> set[str]:
        """Return the names of the views that the tracks have, or that a later split or unmerge could restore."""
        merged = [track for tracks in self.absorbed.values() for track in tracks]
        own = {view.name for track in (*self.everywhere(), *merged) for view in track.views}
        return own.union(views_in(join for joins in self.joins.values() for join in joins))

    def advance_clock(self, stamp_ns: int) -> None:
        """Advance the clock to a stamp."""
        self.keyframe_ns = 0 if self.stamp_ns is None else max(0, stamp_ns - self.stamp_ns)
        self.clock_ns += self.keyframe_ns
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
        """Add a view to those whose pixels are kept."""
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
    def of_parts(cls, parts: Mapping[str, Any], empty: "MapState") -> Self:
        """Return the state of `parts`; `empty` is a new map's. Raises `ValueError` if another version wrote them."""
        expected = {name: getattr(empty, name) for name in _PARTS}
        if parts.keys() != expected.keys():
            raise ValueError(f"a state of {sorted(parts)}; expected {sorted(expected)}")
        values = dict(parts)
        for name, value in expected.items():
            if isinstance(value, (list, dict, set, TrackTable)):  # a written state has tuples where there were lists
                values[name] = type(value)(parts[name])
        return cls(**values)

    def going_on_after(self, later: "MapState", lost_views: Collection[str]) -> None:
        """Prepare this earlier state for continuing after a rewind from `later`; see `MapperCore.going_on_after`."""
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
