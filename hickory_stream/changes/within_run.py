"""What became of things within one run while the robot was away: gone, new or moved, told from what was no object.

The life cycle of tracks says which objects a map has no more and which it has in addition. Why, the two maps say that
it held before and after: what was seen through where an object stood is gone; what stands where there was free space is
new; and of those, two that look alike are one that was moved (`compare.py`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.changes.compare import compare_maps
from hickory_stream.changes.records import Verdict
from hickory_stream.engine.history.time_travel import Change, changes

if TYPE_CHECKING:
    from hickory_stream.changes.records import ChangesConfig
    from hickory_stream.records import MapSnapshot


def changes_within_run(
    before: MapSnapshot, after: MapSnapshot, config: ChangesConfig | None = None
) -> tuple[Change, ...]:
    """Return what happened to the objects between two moments of a run, in the order of their ids.

    As `time_travel.changes`, but that objects which the later map lacks or has in addition are "gone", "new" or "moved"
    where the space that was observed says so, with the probability of it.

    Args:
        before: the map as it was known at the earlier moment.
        after: as it was known at the later one.
        config: when something counts as changed.
    """
    listed = changes(before, after)
    dropped = {one.object_id for one in listed if one.kind == "dropped"}
    appeared = {one.object_id for one in listed if one.kind == "appeared"}
    found = {
        (one.id_a, one.id_b): one
        for one in compare_maps(before, after, np.eye(4), 0.0, config).changes
        if one.id_a in dropped | {None} and one.id_b in appeared | {None}
    }
    said: dict[int, Change | None] = {}
    for (id_a, id_b), one in found.items():
        free = f"{one.evidence.free:.0%} of its place"
        if one.verdict is Verdict.MOVED and id_a is not None and id_b is not None and one.shift_m is not None:
            text = f"by {float(np.linalg.norm(one.shift_m)):.2f} m: it was #{id_a}, and {free} there is free by now"
            moved = Change(kind="moved", object_id=id_b, text=text, probability=one.probability, was=id_a)
            said |= {id_a: None, id_b: moved}
        elif one.verdict is Verdict.GONE and id_a is not None:
            text = f"{free} is free by now"
            said[id_a] = Change(kind="gone", object_id=id_a, text=text, probability=one.probability)
        elif one.verdict is Verdict.NEW and id_b is not None:
            text = f"{free} was free before"
            said[id_b] = Change(kind="new", object_id=id_b, text=text, probability=one.probability)
    told = (said.get(one.object_id, one) if one.kind in ("dropped", "appeared") else one for one in listed)
    return tuple(one for one in told if one is not None)
