"""Why true objects are missing in a map, and the origins of its false objects."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace

from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.evaluation.false_origins import FalseObject, origin_of
from hickory_stream.evaluation.match import Score, TruthScore, best_box, meshes_of, score_map
from hickory_stream.evaluation.miss_reasons import Evidence, Missed, state_of, why_missed
from hickory_stream.evaluation.overlap import Overlap
from hickory_stream.evaluation.placement import placed_truth
from hickory_stream.evaluation.truth import Truth
from hickory_stream.evaluation.truth_sightings import Sighting, sightings_of_truth
from hickory_stream.inspection.track_history import Stretch, TrackStory, stretches_of, track_story
from hickory_stream.map_folder.history.recorded import final_snapshot
from hickory_stream.map_folder.history.recorded_config import known_config
from hickory_stream.map_folder.saved_map import SavedMap
from hickory_stream.records import Phase


@dataclass(frozen=True, kw_only=True, slots=True)
class ReasonCount:
    """Number of missed or false objects with one reason."""

    reason: str
    count: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Why:
    """Reasons and origins of a whole map.

    `num_truth` true objects count, `num_little_seen` do not. `num_aside` of `num_objects` (without tentative ones) lie
    on true objects that do not count, `num_structure` are fixtures on structure.
    """

    num_truth: int
    num_reachable: int | None
    num_little_seen: int
    num_objects: int
    num_aside: int
    num_structure: int
    num_keyframes: int
    reasons: tuple[ReasonCount, ...]
    origins: tuple[ReasonCount, ...]
    missed: tuple[Missed, ...]
    false: tuple[FalseObject, ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Investigation:
    """A map, a truth in the same world, their comparison, and the sightings of the truth."""

    truth: Truth
    score: Score
    evidence: Evidence

    def row(self, truth_id: int) -> TruthScore:
        """Return the score of a true object; raises `InputError` for an unknown id."""
        for row in self.score.truth:
            if row.truth_id == truth_id:
                return row
        known = ", ".join(str(row.truth_id) for row in self.score.truth)
        raise InputError(f"found --object {truth_id}, expected the id of a true object: {known}")


def investigate(saved: SavedMap, truth: Truth) -> Investigation:
    """Return the evidence of a map and its journal about a truth; an unfinished run counts as far as it came.

    Raises `MapFolderError` for the journal or a mesh, `RecordingError` for the truth, `InputError` without Open3D.
    """
    saved = replace(saved, snapshot=final_snapshot(saved.folder))
    placed = placed_truth(saved, truth).truth
    meshes = meshes_of(saved)
    mapping = known_config(saved.folder).mapping
    sightings = sightings_of_truth(saved.folder, saved.snapshot, placed)
    evidence = Evidence(
        names={item.id: f"{item.id} {item.kind}" for item in placed.objects},
        sightings=sightings,
        overlap=Overlap(saved.snapshot, placed),
        boxes={o.id: best_box(o, meshes) for o in saved.snapshot.objects if o.phase is not Phase.TENTATIVE},
        confirm_s=mapping.lifecycle.confirm_s,
    )
    score = score_map(saved.snapshot, meshes, placed, sightings.depth_on)
    return Investigation(truth=placed, score=score, evidence=evidence)


@dataclass(frozen=True, kw_only=True, slots=True)
class NoWhy:
    """The reason why a map has no history."""

    reason: str


def reasons_of(saved: SavedMap, truth: Truth) -> Why | NoWhy:
    """Return the reasons and origins of a map; `NoWhy` without a journal, as for a merged map.

    Raises `RecordingError` for the truth, `InputError` without Open3D.
    """
    try:
        return why_of(investigate(saved, truth))
    except MapFolderError as error:
        return NoWhy(reason=str(error))


def why_of(found: Investigation) -> Why:
    """Return the reason of every true object that counts and is missed, and the origin of every false object."""
    score, evidence = found.score, found.evidence
    counting = [row for row in score.truth if row.counts]
    missed = tuple(why_missed(row.truth_id, row.track_ids, evidence) for row in counting if row.map_id is None)
    matched = {row.map_id for row in counting}
    aside = set(score.ignored_ids) - matched
    right = matched | aside | set(score.structure_ids)
    owners = {i: row.truth_id for row in score.truth for i in row.track_ids}
    tracks_of = {row.truth_id: _on_or_matched(row) for row in score.truth}
    false = tuple(origin_of(i, owners.get(i), tracks_of, evidence) for i in sorted(evidence.boxes) if i not in right)
    return Why(
        num_truth=score.num_truth,
        num_reachable=score.num_reachable,
        num_little_seen=len(score.truth) - len(counting),
        num_objects=score.num_objects,
        num_aside=len(aside),
        num_structure=len(score.structure_ids),
        num_keyframes=evidence.sightings.num_keyframes,
        reasons=_counts(item.reason for item in missed),
        origins=_counts(item.origin for item in false),
        missed=missed,
        false=false,
    )


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectStory:
    """The history of one true object; `missed` is None if it is matched or does not count."""

    truth_id: int
    kind: str
    seen_fraction: float
    counts: bool
    map_id: int | None
    is_fixture: bool
    iou: float
    missed: Missed | None
    tracks: tuple[TrackStory, ...]
    stretches: tuple[Stretch, ...]
    sightings: tuple[Sighting, ...]


def story_of(found: Investigation, truth_id: int) -> ObjectStory:
    """Return the history of a true object by keyframe; raises `InputError` for an unknown id."""
    row, evidence = found.row(truth_id), found.evidence
    sightings = evidence.sightings.of_object[truth_id]
    tracks = Counter(
        part.track_id
        for sighting in sightings
        for part in sighting.parts
        if part.track_id is not None and part.share >= 0.2
    )
    histories = evidence.sightings.histories
    is_missed = row.counts and row.map_id is None
    return ObjectStory(
        truth_id=truth_id,
        kind=row.kind,
        seen_fraction=next(item.seen_fraction for item in found.truth.objects if item.id == truth_id),
        counts=row.counts,
        map_id=row.map_id,
        is_fixture=row.is_fixture,
        iou=row.iou,
        missed=why_missed(truth_id, row.track_ids, evidence) if is_missed else None,
        tracks=tuple(
            track_story(histories.by_id[i], histories.final(i)) for i in sorted(tracks) if i in histories.by_id
        ),
        stretches=stretches_of((s.frame, sighting_text(s, evidence)) for s in sightings),
        sightings=sightings,
    )


def sighting_text(sighting: Sighting, evidence: Evidence) -> str:
    """Return the labels of an object in a keyframe in words; equal labels give equal words."""
    state = state_of(sighting)
    masks = [part for part in sighting.parts if part.where == "mask"]
    if state == "in a mask of its own":
        return f"in a mask of its own, which went to #{masks[0].track_id}"
    if state == "in one mask with another":
        other = masks[0].others[0].truth_id if masks[0].others else None
        name = "structure" if other is None else evidence.names[other]
        return f"in one mask with {name}, which went to #{masks[0].track_id}"
    if state == "in pieces":
        return f"in pieces, which went to {', '.join(f'#{part.track_id}' for part in masks)}"
    if state == "mask rejected":
        reason = next(part.reason for part in sighting.parts if part.where == "rejected mask")
        return f"its mask was rejected: {reason}"
    return state


def _counts(reasons: Iterable[str]) -> tuple[ReasonCount, ...]:
    counted = Counter(reasons)
    return tuple(
        ReasonCount(reason=reason, count=count)
        for reason, count in sorted(counted.items(), key=lambda p: (-p[1], p[0]))
    )


def _on_or_matched(row: TruthScore) -> tuple[int, ...]:
    return tuple(sorted({*row.track_ids, *([] if row.map_id is None else [row.map_id])}))
