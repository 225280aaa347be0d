"""Merging of tracks: duplicates, whose points coincide, and fragments, which frames mostly segment as one object.

One under-segmented frame must not merge two objects: points on another track are not fused, but count as a vote.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.boxes import box_iou, intersection_volume_m3
from hickory_stream.geometry.voxels import contains
from hickory_stream.mapping.entities.cloud import Cloud, fuse, is_near, share_near, sigma_of
from hickory_stream.mapping.entities.track import Track, with_cloud
from hickory_stream.mapping.entities.track_table import TrackTable
from hickory_stream.mapping.entities.views import better, covers_better
from hickory_stream.mapping.rules.association import ALIKE_IOU
from hickory_stream.mapping.rules.lifecycle import Guard, LifeEvent, transition
from hickory_stream.mapping.rules.support_graph import SupportGraph
from hickory_stream.mapping.rules.support_relations import COLUMN_M, MEET_M
from hickory_stream.records import Phase, View

# Minimum share of the smaller cloud's voxels on the larger one for duplicates; and for tracks that were seen apart
# more often than together, or of which one alone is attached to the room.
DUPLICATE_SHARE = 0.5
SURE_SHARE = 0.7
# An observation of one track that covers this share of another is a vote for a merge.
_COVERS_SHARE = 0.3
# Clouds whose depth is less sure than this many voxels are compared in cells of about half a standard deviation.
_NOISY_VOXELS = 8.0


@dataclass(frozen=True, kw_only=True, slots=True)
class MergeConfig(Ranged):
    """When two tracks are merged."""

    #: Minimum time for which keyframes saw two tracks as one, and longer than they saw them apart.
    min_together_s: float = number(0.75, 0, 1e9, "s")


@dataclass(frozen=True, slots=True)
class Votes:
    """For how long keyframes segmented a pair of tracks together, and apart while close to each other."""

    together_ns: int = 0
    apart_ns: int = 0


@dataclass(frozen=True, slots=True)
class VoteRow:
    """The votes of one track with others, by their ids; immutable."""

    votes: Mapping[int, Votes]


@dataclass(frozen=True, kw_only=True, slots=True)
class VoteBook:
    """The votes of pairs of tracks, in the rows of both. A book shares rows with its predecessor."""

    rows: Mapping[int, VoteRow] = field(default_factory=dict)

    @property
    def votes(self) -> dict[tuple[int, int], Votes]:
        """The votes by pair (a, b), a < b."""
        return {(a, b): votes for a, row in self.rows.items() for b, votes in row.votes.items() if a < b}

    def of(self, a: int, b: int) -> Votes:
        """Return the votes of a pair."""
        return self.rows.get(a, _NO_ROW).votes.get(b, _NO_VOTES)

    def plus(self, pairs: Iterable[tuple[int, int]], *, together_ns: int = 0, apart_ns: int = 0) -> "VoteBook":
        """Return the book with these votes added to each pair."""
        added = {pair: Votes(together_ns, apart_ns) for pair in pairs}
        return self._changed([], added) if added else self

    def merged(self, kept: int, gone: int) -> "VoteBook":
        """Return the book after track `gone` was merged into `kept`, which takes over its votes."""
        row = self.rows.get(gone)
        if row is None:
            return self
        # A keyframe that saw both together with another track is one look: looks that both share count once.
        added = {
            (kept, other): replace(votes, together_ns=max(votes.together_ns - self.of(kept, other).together_ns, 0))
            for other, votes in row.votes.items()
            if other != kept
        }
        return self._changed([gone], added)

    def all_of(self, track_id: int) -> Mapping[int, Votes]:
        """Return the votes of a track with others, by their ids."""
        return self.rows.get(track_id, _NO_ROW).votes

    def unmerged(self, host: int, rest: int, far: int, votes: Mapping[int, Votes]) -> "VoteBook":
        """Return the book after `far`, with its `votes`, was taken out of a host, which is `rest` without it."""
        added = {(far, other): own for other, own in votes.items()}
        for other, vote in self.all_of(host).items():
            own = votes.get(other, _NO_VOTES)
            left = Votes(max(vote.together_ns - own.together_ns, 0), max(vote.apart_ns - own.apart_ns, 0))
            if left != _NO_VOTES:
                added[rest, other] = left
        return self._changed([host] if host in self.rows else [], added)

    def without(self, gone: int) -> "VoteBook":
        """Return the book without a dropped track."""
        return self._changed([gone], {}) if gone in self.rows else self

    def _changed(self, gone: Iterable[int], added: Mapping[tuple[int, int], Votes]) -> "VoteBook":
        rows = dict(self.rows)
        new: dict[int, dict[int, Votes]] = {}
        for track_id in gone:
            for other in rows.pop(track_id).votes:
                del _own(new, rows, other)[track_id]
        for (a, b), more in added.items():
            old = _own(new, rows, a).get(b, _NO_VOTES)
            votes = Votes(old.together_ns + more.together_ns, old.apart_ns + more.apart_ns)
            _own(new, rows, a)[b] = _own(new, rows, b)[a] = votes
        for track_id, row in new.items():
            if row:
                rows[track_id] = VoteRow(row)
            else:
                rows.pop(track_id, None)
        return VoteBook(rows=rows)


_NO_ROW = VoteRow({})
_NO_VOTES = Votes()


def _own(new: dict[int, dict[int, Votes]], rows: Mapping[int, VoteRow], track_id: int) -> dict[int, Votes]:
    if track_id not in new:
        new[track_id] = dict(rows.get(track_id, _NO_ROW).votes)
    return new[track_id]


def pair_of(a: int, b: int) -> tuple[int, int]:
    """Return a pair of tracks, the lower id first."""
    return min(a, b), max(a, b)


def pairs_of_groups(members: Iterable[tuple[int, int]]) -> set[tuple[int, int]]:
    """Return the pairs of tracks in the same group, from (group, track id) members; group 0 means no group."""
    tracks: dict[int, set[int]] = {}
    for group, track_id in members:
        if group > 0:
            tracks.setdefault(group, set()).add(track_id)
    return {pair for ids in tracks.values() for pair in combinations(sorted(ids), 2)}


def pairs_that_meet(bounds: Sequence[NDArray[np.float32]], track_ids: Sequence[int]) -> set[tuple[int, int]]:
    """Return the pairs of tracks whose observations' bounds (2, 3) touch or nearly touch."""
    both = np.array(bounds).reshape(-1, 2, 3)
    low, high = both[:, 0], both[:, 1]
    meet = (low[:, None] <= high[None] + MEET_M).all(axis=2) & (low[None] <= high[:, None] + MEET_M).all(axis=2)
    return {pair_of(track_ids[i], track_ids[j]) for i, j in zip(*np.nonzero(np.triu(meet, 1)), strict=True)}


def points_on_others(cloud: Cloud, own: Track, others: Iterable[Track]) -> tuple[NDArray[np.bool_], list[int]]:
    """Return which voxels (N,) of an observation are on other tracks but not its own, and the ids of covered tracks."""
    on_others = np.zeros(len(cloud.keys), dtype=bool)
    covered: list[int] = []
    for other in others:
        on_other = is_near(cloud.keys, other.cloud)
        if on_other.any():
            on_others |= on_other
            if on_other.sum() >= _COVERS_SHARE * min(len(other.solid.keys), len(cloud.keys)):
                covered.append(other.id)
    if on_others.any():
        # Exactly the same voxel: if neighbours counted, a track would grow into another one, keyframe by keyframe.
        on_others &= ~contains(own.cloud.keys, cloud.keys)
    return on_others, covered


def find_pair(
    tracks: TrackTable, changed: Iterable[int], book: VoteBook, graph: SupportGraph, voxel_m: float, config: MergeConfig
) -> tuple[int, int, str] | None:
    """Return (kept id, gone id, reason) of the first pair of tracks to merge, None if there is none."""
    for i in sorted(changed):
        if i not in tracks:
            continue
        near = tracks.touching(tracks[i].bounds, COLUMN_M)
        for other in near:
            if other.id != i and (reason := why_one(tracks[i], other, near, book, graph, voxel_m, config)) is not None:
                return min(i, other.id), max(i, other.id), reason
    return None


def merge(kept: Track, gone: Track, voxel_m: float) -> Track:
    """Return the merged track, with the id of `kept` and the histories of both."""
    sightings = max(kept.sightings, gone.sightings)
    merged = with_cloud(kept, fuse(kept.cloud, gone.cloud), sightings, voxel_m)
    return replace(
        with_better_views(merged, gone),
        phase=_phase_after(kept, gone),
        judged_points=0,
        first_seen_ns=min(kept.first_seen_ns, gone.first_seen_ns),
        last_seen_ns=max(kept.last_seen_ns, gone.last_seen_ns),
        seen_clock_ns=max(kept.seen_clock_ns, gone.seen_clock_ns),
        shape=kept.shape or gone.shape,
        merged_ids=tuple(sorted({*kept.merged_ids, *gone.merged_ids, gone.id})),
        seen_through_ns=min(kept.seen_through_ns, gone.seen_through_ns),
        observed_ns=max(kept.observed_ns, gone.observed_ns),
        seen_in=max(kept.seen_in, gone.seen_in),
    )


def with_better_views(track: Track, other: Track) -> Track:
    """Return a track with its own views and better ones of another track, all under its own id."""

    def own(view: View) -> View:
        return view if view.object_id == track.id else replace(view, object_id=track.id)

    coverage = {sector: own(view) for sector, view in track.coverage}
    best = None if track.best_view is None else own(track.best_view)
    for sector, view in other.coverage:
        if covers_better(own(view), coverage.get(sector)):
            coverage[sector] = own(view)
    theirs = None if other.best_view is None else own(other.best_view)
    return replace(track, coverage=tuple(sorted(coverage.items())), best_view=better(best, theirs))


def _phase_after(kept: Track, gone: Track) -> Phase:
    holds = {Guard.OTHER_SEEN_MORE: gone.sightings > kept.sightings}
    return kept.phase if transition(kept.phase, LifeEvent.TAKES_IN, holds.__getitem__) is None else gone.phase


def why_one(
    a: Track, b: Track, near: Sequence[Track], book: VoteBook, graph: SupportGraph, voxel_m: float, config: MergeConfig
) -> str | None:
    """Return the reason to merge two tracks, None if there is none; `near` are the tracks around them."""
    least_ns = 1e9 * config.min_together_s
    is_known = min(a.observed_ns, b.observed_ns) >= least_ns
    # The column between a seat and its foot may be too thin for the sensor: the two need not touch.
    if is_known and not (a.is_promoted or b.is_promoted) and (part := graph.foot_of(a, b)) is not None:
        return part.reason
    # The boxes of touching tracks intersect, given a few centimetres of slack.
    if intersection_volume_m3(a.box, b.box, 0.03) <= 0.0:
        return None
    votes = book.of(a.id, b.id)
    reason = _why_one_thing(a, b, votes, voxel_m, least_ns)
    if reason is not None:
        return reason
    less, more = (a, b) if a.box.volume_m3 <= b.box.volume_m3 else (b, a)
    if not is_known or less.is_promoted:
        return None
    # A patch is of its thing's kind, and was not known longer.
    may_be_patch = a.is_attached == b.is_attached and less.observed_ns <= more.observed_ns
    seen_apart = votes.apart_ns > votes.together_ns
    part = graph.part_of(less, more, near, seen_apart=seen_apart, may_be_patch=may_be_patch)
    return None if part is None else part.reason


def _why_one_thing(a: Track, b: Track, votes: Votes, voxel_m: float, least_ns: float) -> str | None:
    # Frames that see a picture and its wall as one do not make them so. A size alone, which grows, divides nothing.
    is_one_kind = a.is_attached == b.is_attached
    # Frames tear leaves and cloth at every gap in depth: boxes as like as those of a view and its track outvote them.
    is_one_place = not (a.is_promoted or b.is_promoted) and box_iou(a.box, b.box) >= ALIKE_IOU
    if is_one_kind and votes.together_ns >= least_ns and (votes.together_ns > votes.apart_ns or is_one_place):
        return f"seen as one for {votes.together_ns / 1e9:.1f} s, apart for {votes.apart_ns / 1e9:.1f} s"
    small, large = (a, b) if len(a.solid.keys) <= len(b.solid.keys) else (b, a)
    share = share_near(small.solid.keys, large.solid)
    if not is_one_kind:
        # The smaller is a side of the larger, e.g. the front of a wardrobe.
        same = f"{share:.0%} of the smaller, {small.kind}, lies on the larger, {large.kind}"
        return None if share < SURE_SHARE else same
    if share >= (SURE_SHARE if votes.apart_ns > votes.together_ns else DUPLICATE_SHARE):
        return f"{share:.0%} of the smaller cloud lies on the larger one"
    if votes.apart_ns > 0:
        return None
    # From far away a thing is spread along the rays, and its near views lie within that: two tracks of one thing.
    noise = max(sigma_of(a.solid), sigma_of(b.solid)) / voxel_m
    if noise < _NOISY_VOXELS:
        return None
    share = share_near(small.solid.keys, large.solid, halvings=int(noise / 2).bit_length() - 1)
    same = f"{share:.0%} of the smaller cloud lies on the larger one, to within noise"
    return None if share < DUPLICATE_SHARE else same
