"""What `diff MAP T1 T2` says of a run in which things are moved, removed and added behind the robot's back."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from hickory_stream.changes.within_run import changes_within_run
from hickory_stream.evaluation.match import MIN_SEEN, score_map
from tools.benchmarks.change_counts import PairCounts
from tools.benchmarks.changed_maps import mapped
from tools.benchmarks.looked_at import scene_of, share_looked_at
from tools.worlds.recording_config import RecordingConfig

if TYPE_CHECKING:
    from pathlib import Path

    from hickory_stream.evaluation.truth import Truth
    from hickory_stream.map_folder.saved_map import SavedMap

_SECONDS, _CHANGE_AT_S = 60.0, 28.0


def run_counts(state: Path, seed: int) -> PairCounts:
    """Return what was said of a walk through a room that changes when it is half over."""
    config = RecordingConfig(
        scene="room", seed=seed, seconds=_SECONDS, rate_hz=4.0, width=480, height=270, change_at_s=_CHANGE_AT_S
    )
    return counts_of_run(*mapped(config, state / f"room-{seed}-changes.map"))


def counts_of_run(truth: Truth, saved: SavedMap) -> PairCounts:
    """Return what is said of the time from just before the change of a truth to the end, against that change.

    A change counts if enough was seen of the object, and of its place when it was not there.
    """
    assert truth.change is not None
    before = saved.as_known_at(truth.change.stamp_ns - 1)
    after = saved.as_known_at(truth.frames[-1].stamp_ns)
    changed = {item.id: item for item in truth.change.before}
    was = tuple(item for item in truth.objects if item.id not in changed and item.id in _old_ids(truth))
    truth_before = replace(truth, objects=tuple(sorted((*was, *changed.values()), key=lambda item: item.id)))
    in_a, in_b = (
        {row.truth_id: row.map_id for row in score_map(snapshot, {}, one).truth if row.counts}
        for snapshot, one in ((before, truth_before), (after, truth))
    )
    in_a = _looked_at(in_a, truth_before, truth, after_change=True)
    in_b = _looked_at(in_b, truth, truth_before, after_change=False)
    told = [one for one in changes_within_run(before, after) if one.probability is not None]
    gone = {one.object_id for one in told if one.kind == "gone"}
    moved = {one.was: one.object_id for one in told if one.kind == "moved" and one.was is not None}
    new = {one.object_id for one in told if one.kind == "new"}
    return counted(truth, (in_a, in_b), gone, moved, new)


def _looked_at(held: dict[int, int | None], own: Truth, other: Truth, *, after_change: bool) -> dict[int, int | None]:
    """Return those objects of one side of the change of whose places enough is looked at on the other side."""
    assert own.change is not None
    scene = scene_of(other)
    frames = [one for one in own.frames if (one.stamp_ns >= own.change.stamp_ns) == after_change]
    objects = {item.id: item for item in own.objects}
    return {i: map_id for i, map_id in held.items() if share_looked_at(own, objects[i], frames, scene) >= MIN_SEEN}


def _old_ids(truth: Truth) -> set[int]:
    """Return the ids of the objects that were there before the change, moved ones left out."""
    assert truth.change is not None
    first_ns = truth.change.stamp_ns
    frames_before = {frame.index for frame in truth.frames if frame.stamp_ns < first_ns}
    # What is new shows in no frame of before; what never showed there is no object of the earlier map either.
    return {item.id for item in truth.objects if frames_before.intersection(item.frames)}


def counted(
    truth: Truth,
    held: tuple[dict[int, int | None], dict[int, int | None]],
    gone: set[int],
    moved: dict[int, int],
    new: set[int],
) -> PairCounts:
    """Return how what is said compares with the change of a truth.

    Args:
        truth: of a world that changed.
        held: object of the map by true object, before and after, of those of which enough was seen.
        gone: objects of the earlier map that are said to be so.
        moved: objects of the later map, by what they were in the earlier one.
        new: objects of the later map that are said to be so.
    """
    assert truth.change is not None
    in_a, in_b = held
    changed = {item.id for item in truth.change.before}
    at_end = {item.id for item in truth.objects}
    old = _old_ids(truth)
    rows: list[tuple[bool, bool]] = []
    moved_held = as_moved = 0
    for i in sorted(changed & at_end & in_a.keys() & in_b.keys()):
        a, b = in_a[i], in_b[i]
        is_held = a is not None and b is not None
        is_moved = is_held and moved.get(a) == b
        rows.append((is_held, is_moved or (a in gone and b in new)))
        moved_held += is_held
        as_moved += is_moved
    rows += [(in_a[i] is not None, in_a[i] in gone) for i in sorted(changed - at_end) if i in in_a]
    rows += [(in_b[i] is not None, in_b[i] in new) for i in sorted(at_end - changed - old) if i in in_b]
    stayed = [i for i in sorted(at_end - changed) if i in old and (in_a.get(i) is not None or in_b.get(i) is not None)]
    named_a, named_b = gone | moved.keys(), new | set(moved.values())
    wrong = sum(in_a.get(i) in named_a or in_b.get(i) in named_b for i in stayed)
    return PairCounts(
        changes=len(rows), found=sum(found for _, found in rows),
        held=sum(held for held, _ in rows), held_found=sum(held and found for held, found in rows),
        moved_held=moved_held, moved_as_moved=as_moved, objects=len(stayed), false_changes=wrong,
        gone=len(gone), aligned=1,
    )  # fmt: skip
