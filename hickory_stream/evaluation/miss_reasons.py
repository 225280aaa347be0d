"""The reason why a true object is missed: the first that holds of a closed list, with supporting counts.

In order: out of reach; in pieces, or a wrong box; too small in every keyframe; absorbed by another object; the label of
most keyframes, or the end of its own tracks.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hickory_stream.evaluation.match import MIN_DEPTH_KEYFRAMES
from hickory_stream.evaluation.overlap import LiesOn, Overlap
from hickory_stream.evaluation.truth_sightings import Part, Sighting, TruthSightings
from hickory_stream.geometry.boxes import OrientedBox, box_iou
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.inspection.track_history import ending_text, when
from hickory_stream.map_folder.history.track_histories import Ending
from hickory_stream.mapping.rules.lifecycle import LONGEST_NS

MissReason = Literal[
    "out of reach",
    "too small in the image",
    "no depth",
    "taken for structure",
    "in no mask",
    "mask rejected",
    "one mask with another",
    "merged with another",
    "in pieces",
    "too few sightings",
    "dropped as structure",
    "looked through",
    "box is off",
]

MISS_REASONS: dict[MissReason, str] = {
    "out of reach": "fewer than three keyframes have depth on it: no map can have it",
    "too small in the image": "too few keyframes for a track show it larger than the smallest 2 % of the run's masks",
    "no depth": "most keyframes have no depth on it",
    "taken for structure": "most keyframes label it as floor, wall or ceiling",
    "in no mask": "most keyframes have depth on it, but label it neither as structure nor as part of a mask",
    "mask rejected": "most keyframes reject its mask",
    "one mask with another": "its masks, or those of the object that absorbed it, show mostly something else",
    "merged with another": "it has masks of its own, but another object took over their track, or its points",
    "in pieces": "the map has several objects on it, or most keyframes several masks",
    "too few sightings": "its sightings are too little evidence for a track, or went to several tracks",
    "dropped as structure": "its track was classified as structure, or found to lie inside structure",
    "looked through": "its track was dropped because later depth was measured behind it",
    "box is off": "one object lies on it, but their boxes have an IoU under 0.25",
}

State = Literal[
    "in a mask of its own",
    "in one mask with another",
    "in pieces",
    "taken for structure",
    "mask rejected",
    "without depth",
    "in no mask",
]
_REASON_OF: dict[State, MissReason] = {
    "in one mask with another": "one mask with another",
    "in pieces": "in pieces",
    "taken for structure": "taken for structure",
    "mask rejected": "mask rejected",
    "without depth": "no depth",
    "in no mask": "in no mask",
}
_HALF = 0.5
# An object that covers this share of a missed true object has absorbed it.
_SWALLOWED = 0.3
_EXTENT_SLACK_M, _EXTENT_SLACK = 0.03, 0.1


@dataclass(frozen=True, kw_only=True, slots=True)
class Missed:
    """A true object without a match; `map_ids` are the mapped objects in the text.

    `best_frame` is the frame of the keyframe with most pixels of it, None if no keyframe shows it.
    """

    truth_id: int
    kind: str
    reason: MissReason
    text: str
    map_ids: tuple[int, ...]
    best_frame: int | None


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """Input to all reasons; `names` are of true objects, `boxes` of the map's objects.

    A track is confirmed when it was observed for `confirm_s`.
    """

    names: Mapping[int, str]
    sightings: TruthSightings
    overlap: Overlap
    boxes: Mapping[int, OrientedBox]
    confirm_s: float

    @property
    def fewest_sightings(self) -> int:
        """The least number of sightings that can confirm a track, with pauses that count whole."""
        return 1 + int(np.ceil(1e9 * self.confirm_s / LONGEST_NS))

    @property
    def what_confirms(self) -> str:
        """What confirms a track, in words."""
        return (
            f"a track takes {self.confirm_s:g} s of observation, of which a pause adds at most {LONGEST_NS / 1e9:g} s"
        )


def state_of(sighting: Sighting) -> State:
    """Return the label of an object in a keyframe."""
    masks = [part for part in sighting.parts if part.where == "mask"]
    if sum(part.share for part in masks) >= _HALF:
        if masks[0].share >= _HALF:
            return "in a mask of its own" if _is_own(masks[0]) else "in one mask with another"
        return "in pieces" if _is_own(masks[0]) else "in one mask with another"
    shares: dict[State, float] = {
        "taken for structure": sighting.share("structure"),
        "mask rejected": sighting.share("rejected mask"),
        "without depth": sighting.share("no depth"),
        "in no mask": sighting.share("no mask"),
    }
    best = max(shares, key=lambda state: shares[state])
    if masks and masks[0].share > shares[best]:
        return "in a mask of its own" if _is_own(masks[0]) else "in one mask with another"
    return best


def why_missed(truth_id: int, track_ids: Sequence[int], evidence: Evidence) -> Missed:
    """Return why a true object is missed; `track_ids` are the objects mostly on it."""
    seen = evidence.sightings.of_object[truth_id]
    message = tally_text(Counter(state_of(sighting) for sighting in seen), len(seen))
    num_depth = evidence.sightings.depth_on.get(truth_id, 0)
    if num_depth < MIN_DEPTH_KEYFRAMES:
        text = f"keyframes with depth on 64 and more of its pixels (of 640 x 480): {num_depth}; {message}"
        text = text if seen else f"none of {evidence.sightings.num_keyframes} keyframes shows it"
        return _missed(truth_id, "out of reach", text, track_ids, evidence)
    if track_ids:
        return _has_objects(truth_id, track_ids, evidence)
    smallest = evidence.sightings.smallest_mask_px
    large = [sighting for sighting in seen if sighting.num_px >= smallest]
    covered = evidence.overlap.covered(truth_id)
    swallower = min(covered, key=lambda i: (-covered[i], i), default=None)
    if swallower is not None and covered[swallower] >= _SWALLOWED:
        return _swallowed(truth_id, swallower, message, evidence)
    needed = evidence.fewest_sightings
    if len(large) < needed:
        most = max(sighting.num_px for sighting in seen)
        often = f"it has that in {len(large)} of {len(seen)} keyframes, at most {most}"
        text = f"98 % of the masks have {smallest:.0f} pixels and more, {often}"
        return _missed(truth_id, "too small in the image", f"{text}; {message}", (), evidence)
    states = [state_of(sighting) for sighting in large]
    tally = Counter(states)
    common = max(tally, key=lambda state: tally[state])
    if common == "in a mask of its own":
        return _lost_track(truth_id, large, states, message, evidence)
    reason = _REASON_OF[common]
    shown = [sighting for sighting, state in zip(large, states, strict=True) if state == common]
    return _missed(truth_id, reason, f"{message}; {_detail(common, shown, evidence)}", (), evidence)


def tally_text(tally: Counter[State], count: int) -> str:
    """Return how often an object was given each label, the most frequent first."""
    parts = ", ".join(f"{number} {state}" for state, number in sorted(tally.items(), key=lambda kv: (-kv[1], kv[0])))
    return f"{count} keyframe{'s show' if count > 1 else ' shows'} it: {parts}"


def extents_text(true: OrientedBox, found: OrientedBox) -> str:
    """Return which extents of a box differ from the true ones, and its offset, along the axes of the true box."""
    corners = apply(invert(true.world_from_box), found.corners_world())
    low, high = corners.min(axis=0), corners.max(axis=0)
    half = true.half_extents_m
    order = ("length", "width") if half[0] >= half[1] else ("width", "length")
    differing, off = [], []
    for axis, name in enumerate((*order, "height")):
        size, wanted = float(high[axis] - low[axis]), float(2 * half[axis])
        slack = max(_EXTENT_SLACK_M, _EXTENT_SLACK * wanted)
        if abs(size - wanted) > slack:
            differing.append(f"{name} {size:.2f} m, true {wanted:.2f} m")
        shift = float(low[axis] + high[axis]) / 2
        if abs(shift) > slack:
            off.append(f"{abs(shift):.2f} m in {name}")
    parts = [*differing, *([f"its middle is off by {', '.join(off)}"] if off else [])]
    return "; ".join(parts) or "no extent by more than a tenth: it is turned, or thin"


def lies_on_text(lies_on: LiesOn, names: Mapping[int, str]) -> str:
    """Return which true surfaces the points of an object lie on, the largest shares first."""
    shares = [(share, names.get(i, str(i))) for i, share in lies_on.things.items()]
    shares += [(lies_on.structure, "structure"), (lies_on.nothing, "nothing that the truth has")]
    parts = [f"{share:.0%} {name}" for share, name in sorted(shares, key=lambda p: (-p[0], p[1])) if share >= 0.05]
    return ", ".join(parts)


def _is_own(part: Part) -> bool:
    return part.purity is not None and part.purity >= _HALF


def _missed(truth_id: int, reason: MissReason, text: str, map_ids: Sequence[int], evidence: Evidence) -> Missed:
    seen = evidence.sightings.of_object[truth_id]
    best = max(seen, key=lambda sighting: (sighting.num_px, -sighting.frame), default=None)
    return Missed(
        truth_id=truth_id,
        kind=evidence.names[truth_id],
        reason=reason,
        text=text,
        map_ids=tuple(map_ids),
        best_frame=None if best is None else best.frame,
    )


def _has_objects(truth_id: int, track_ids: Sequence[int], evidence: Evidence) -> Missed:
    true = evidence.overlap.true_boxes[truth_id]
    covered = evidence.overlap.covered(truth_id)
    if len(track_ids) > 1:
        message = ", ".join(f"#{i} has {covered.get(i, 0.0):.0%} of what was seen" for i in track_ids)
        return _missed(truth_id, "in pieces", message, track_ids, evidence)
    found = evidence.boxes[track_ids[0]]
    iou = box_iou(true, found)
    of = lies_on_text(evidence.overlap.lies_on[track_ids[0]], evidence.names)
    text = f"#{track_ids[0]} has a box IoU of only {iou:.2f}: {extents_text(true, found)}; its points are {of}"
    return _missed(truth_id, "box is off", text, track_ids, evidence)


def _swallowed(truth_id: int, map_id: int, details: str, evidence: Evidence) -> Missed:
    tally = Counter(state_of(sighting) for sighting in evidence.sightings.of_object[truth_id])
    of = lies_on_text(evidence.overlap.lies_on[map_id], evidence.names)
    share = evidence.overlap.covered(truth_id)[map_id]
    text = f"{share:.0%} of what was seen of it is in #{map_id}, which is {of}; {details}"
    joined, own = tally["in one mask with another"], tally["in a mask of its own"]
    reason: MissReason = "merged with another" if own > joined else "one mask with another"
    if own > joined:
        tracks = _own_tracks(truth_id, evidence)
        gone = [i for i in tracks if evidence.sightings.histories.final(i) == map_id and i != map_id]
        text += f"; {_merge_text(gone, map_id, evidence)}"
    return _missed(truth_id, reason, text, (map_id,), evidence)


def _merge_text(gone: Sequence[int], map_id: int, evidence: Evidence) -> str:
    histories = evidence.sightings.histories.by_id
    parts = []
    for track_id in gone[:3]:
        ending = histories[track_id].ending
        if ending is not None:
            parts.append(f"its track #{track_id} was merged {when(ending.frame)}: {ending.text}")
    return "; ".join(parts) or f"its masks went to #{map_id} as they were"


def _own_tracks(truth_id: int, evidence: Evidence) -> Counter[int]:
    tracks: Counter[int] = Counter()
    for sighting in evidence.sightings.of_object[truth_id]:
        if state_of(sighting) == "in a mask of its own":
            track_id = next(part.track_id for part in sighting.parts if part.where == "mask")
            if track_id is not None:
                tracks[track_id] += 1
    return Counter(dict(sorted(tracks.items(), key=lambda kv: (-kv[1], kv[0]))))


def _lost_track(
    truth_id: int, large: Sequence[Sighting], states: Sequence[State], details: str, evidence: Evidence
) -> Missed:
    tracks, histories = _own_tracks(truth_id, evidence), evidence.sightings.histories
    own = sum(tracks.values())
    ends: Counter[MissReason] = Counter()
    for track_id, count in tracks.items():
        last = histories.last(track_id)
        ends[_reason_of_end(last.ending if last is not None else None)] += count
    reason = max(ends, key=lambda reason: ends[reason]) if ends else "too few sightings"
    where = "; ".join(
        f"{count} of its {own} masks went to {ending_text(histories, i)}" for i, count in list(tracks.items())[:3]
    )
    more = f" and {len(tracks) - 3} more tracks" if len(tracks) > 3 else ""
    needed = f"; {evidence.what_confirms}" if reason == "too few sightings" else ""
    kept = tuple(sorted({i for track_id in tracks if (i := histories.final(track_id)) is not None}))
    return _missed(truth_id, reason, f"{details}; {where}{more}{needed}", kept, evidence)


def _reason_of_end(ending: Ending | None) -> MissReason:
    if ending is None:
        return "merged with another"
    causes: dict[str | None, MissReason] = {
        "structure": "dropped as structure",
        "in structure": "dropped as structure",
        "looked through": "looked through",
    }
    return causes.get(ending.cause, "too few sightings")


def _detail(state: State, shown: Sequence[Sighting], evidence: Evidence) -> str:
    if state == "taken for structure":
        share = np.mean([sighting.share("structure") for sighting in shown])
        return f"there {share:.0%} of its pixels are taken for floor, wall or ceiling"
    if state == "mask rejected":
        return f"most often: {_most_pixels('rejected mask', shown)}"
    if state == "in one mask with another":
        names: Counter[str] = Counter()
        tracks: Counter[int] = Counter()
        for sighting in shown:
            part = next(part for part in sighting.parts if part.where == "mask")
            names[_other_name(part, evidence)] += 1
            if part.track_id is not None:
                tracks[part.track_id] += 1
        with_what = ", ".join(f"{name} ({count})" for name, count in names.most_common(3))
        end = f"; most of these masks went to {ending_text(evidence.sightings.histories, tracks.most_common(1)[0][0])}"
        return f"with {with_what}{end if tracks else ''}"
    if state == "in pieces":
        return f"{np.median([sum(p.where == 'mask' for p in s.parts) for s in shown]):.0f} masks in the median"
    return f"at {np.median([s.distance_m for s in shown]):.1f} m in the median"


def _other_name(part: Part, evidence: Evidence) -> str:
    if not part.others:
        return "many things"
    other = part.others[0].truth_id
    return "structure" if other is None else evidence.names[other]


def _most_pixels(where: str, shown: Sequence[Sighting]) -> str:
    reasons: Counter[str] = Counter()
    for sighting in shown:
        for part in sighting.parts:
            if part.where == where:
                reasons[part.reason] += 1
    return reasons.most_common(1)[0][0]
