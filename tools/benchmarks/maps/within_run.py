"""Answers of `diff MAP T1 T2` about a run in which things are moved, removed and added out of the robot's sight."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from pathlib import Path

from hickory_stream.changes.within_run import changes_within_run
from hickory_stream.evaluation.match import MIN_SEEN, score_map
from hickory_stream.evaluation.truth import Truth
from hickory_stream.records import MapSnapshot
from tools.benchmarks.common.cached_runs import map_without_shapes
from tools.benchmarks.maps.change_counts import Held, PairCounts, counts_of
from tools.benchmarks.maps.rendered_views import scene_of, seen_share
from tools.evaluation.true_changes import TrueChanges
from tools.worlds.recording_config import RecordingConfig

_SECONDS, _CHANGE_AT_S = 60.0, 28.0


def run_counts(state: Path, seed: int) -> PairCounts:
    """Return the counts of a walk through a room that changes when it is half over."""
    # The answer is about the time from just before the change to the end. A change counts if enough was seen of the
    # object, and of its place when it was not there.
    config = RecordingConfig(
        scene="room", seed=seed, seconds=_SECONDS, rate_hz=4.0, width=480, height=270, change_at_s=_CHANGE_AT_S
    )
    truth, saved = map_without_shapes(config, state / f"room-{seed}-changes.map")
    assert truth.change is not None
    before = saved.as_known_at(truth.change.stamp_ns - 1)
    after = saved.as_known_at(truth.frames[-1].stamp_ns)
    changed = {item.id: item for item in truth.change.before}
    was = tuple(item for item in truth.objects if item.id not in changed and item.id in _old_ids(truth))
    truth_before = replace(truth, objects=tuple(sorted((*was, *changed.values()), key=lambda item: item.id)))
    held_a = _looked_at(before, truth_before, truth, after_change=True)
    held_b = _looked_at(after, truth, truth_before, after_change=False)
    found = [one for one in changes_within_run(before, after) if one.probability is not None]
    gone = {one.object_id for one in found if one.kind == "gone"}
    moved = {one.was: one.object_id for one in found if one.kind == "moved" and one.was is not None}
    new = {one.object_id for one in found if one.kind == "new"}
    return counted(truth, (held_a, held_b), gone, moved, new)


def counted(
    truth: Truth, held: tuple[Held, Held], gone: Collection[int], moved: Mapping[int, int], new: Collection[int]
) -> PairCounts:
    """Return how reported changes compare with the change of a truth; arguments are those of `counts_of`."""
    assert truth.change is not None
    changed, at_end = {item.id for item in truth.change.before}, {item.id for item in truth.objects}
    old = _old_ids(truth)
    true = TrueChanges(
        stayed=tuple(sorted((at_end - changed) & old)), moved=tuple(sorted(changed & at_end)),
        gone=tuple(sorted(changed - at_end)), new=tuple(sorted(at_end - changed - old)),
    )  # fmt: skip
    return counts_of(true, held, gone, moved, new)


def _looked_at(snapshot: MapSnapshot, own: Truth, other: Truth, *, after_change: bool) -> Held:
    assert own.change is not None
    scene = scene_of(other)
    frames = [one for one in own.frames if (one.stamp_ns >= own.change.stamp_ns) == after_change]
    objects = {item.id: item for item in own.objects}
    held = {row.truth_id: row.map_id for row in score_map(snapshot, {}, own).truth if row.counts}
    return {i: map_id for i, map_id in held.items() if seen_share(own, objects[i], frames, scene) >= MIN_SEEN}


def _old_ids(truth: Truth) -> set[int]:
    assert truth.change is not None
    before = {frame.index for frame in truth.frames if frame.stamp_ns < truth.change.stamp_ns}
    # A new object shows in no frame of before; one that never showed there is no object of the earlier map either.
    return {item.id for item in truth.objects if before.intersection(item.frames)}
