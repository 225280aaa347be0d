"""Changes within one run while the robot was away: gone, new or moved.

The life cycle of tracks says which objects vanished or appeared. An object is gone if its place was seen through, new
if it stands in former free space, moved if two of these look alike (`compare.py`). An object that the map still has,
but did not see again, is gone if its place was seen through since: its own points prove nothing.
"""

from dataclasses import replace

import numpy as np

from hickory_stream.changes.compare import compare_maps
from hickory_stream.changes.evidence import (
    SeenPlaces,
    clear_points,
    compared_objects,
    evidence_at,
    not_in_free_space,
    seen_places,
)
from hickory_stream.changes.records import ChangesConfig, ObjectChange, Verdict
from hickory_stream.map_folder.history.time_travel import Change, changes
from hickory_stream.records import MapSnapshot, Phase


def changes_within_run(
    before: MapSnapshot, after: MapSnapshot, config: ChangesConfig | None = None
) -> tuple[Change, ...]:
    """Return the changes of objects between two moments of a run, by id.

    Like `time_travel.changes`, but vanished, added and unseen objects are "gone", "new" or "moved", with a probability,
    where observed space proves it.
    """
    config = config or ChangesConfig()
    listed = changes(before, after)
    not_seen = _not_seen_since(before, after)
    lost = {one.object_id for one in listed if one.kind == "dropped"} | not_seen
    came = {one.object_id for one in listed if one.kind == "appeared"}
    seen_again = replace(after, objects=tuple(item for item in after.objects if item.id not in not_seen))
    was, is_now = (seen_places(compared_objects(one), one.submaps) for one in (before, seen_again))
    said: dict[int, Change | None] = {}
    for one in compare_maps(before, seen_again, np.eye(4), 0.0, config).changes:
        if one.id_a in lost | {None} and one.id_b in came | {None}:
            is_unproven = one.id_a in not_seen and not _is_seen_through_since(was, is_now, one.id_a, config)
            said |= {} if is_unproven else _told(one)
    # Unseen objects have no other entry.
    parts = [said.get(one.object_id, one) if one.kind in ("dropped", "appeared") else one for one in listed]
    parts += [said[i] for i in not_seen & said.keys()]
    return tuple(sorted((one for one in parts if one is not None), key=lambda one: one.object_id))


def _told(one: ObjectChange) -> dict[int, Change | None]:
    free = f"{one.evidence.free:.0%} of its place"
    if one.verdict is Verdict.MOVED and one.id_a is not None and one.id_b is not None and one.shift_m is not None:
        away_m = float(np.linalg.norm(one.shift_m))
        text = f"by {away_m:.2f} m: it was #{one.id_a}, and {free} there is free by now"
        moved = Change(kind="moved", object_id=one.id_b, text=text, probability=one.probability, was=one.id_a)
        return {one.id_a: None, one.id_b: moved}
    if one.verdict is Verdict.GONE and one.id_a is not None:
        text = f"{free} is free by now"
        return {one.id_a: Change(kind="gone", object_id=one.id_a, text=text, probability=one.probability)}
    if one.verdict is Verdict.NEW and one.id_b is not None:
        text = f"{free} was free before"
        return {one.id_b: Change(kind="new", object_id=one.id_b, text=text, probability=one.probability)}
    return {}


def _not_seen_since(before: MapSnapshot, after: MapSnapshot) -> set[int]:
    sightings = {item.id: item.sightings for item in before.objects if item.phase is not Phase.TENTATIVE}
    return {item.id for item in after.objects if sightings.get(item.id) == item.sightings}


def _is_seen_through_since(before: SeenPlaces, after: SeenPlaces, object_id: int, config: ChangesConfig) -> bool:
    # Points in free space before do not count.
    at = next(i for i, item in enumerate(before.objects) if item.id == object_id)
    points = not_in_free_space(before, clear_points(before, at, config.near_m))
    return evidence_at(after, points, config.near_m).free >= config.min_free
