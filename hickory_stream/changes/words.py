"""What changed, in words."""

from __future__ import annotations

from math import hypot
from typing import TYPE_CHECKING

from hickory_stream.changes.records import Verdict

if TYPE_CHECKING:
    from hickory_stream.changes.records import MapChanges, ObjectChange


def count_text(found: MapChanges) -> str:
    """Return how many objects each verdict is of, and how well the maps are aligned."""
    counts = [(verdict, sum(change.verdict is verdict for change in found.changes)) for verdict in Verdict]
    told = ", ".join(f"{count} {verdict}" for verdict, count in counts if count) or "no objects"
    return f"{told}; the maps lie to one another to within {100 * found.sigma_m:.1f} cm"


def sentence(change: ObjectChange) -> str:
    """Return what became of one object."""
    name = " -> ".join(f"#{i}" for i in (change.id_a, change.id_b) if i is not None)
    if change.shift_m is not None:
        x, y, z = change.shift_m
        name += f" by {hypot(x, y, z):.2f} m ({x:+.2f}, {y:+.2f}, {z:+.2f})"
    return f"{name}, probability {change.probability:.2f}"


def evidence_text(change: ObjectChange) -> str:
    """Return what the other map saw in an object's place."""
    seen = change.evidence
    if not seen.num_clear:
        return "nothing of it stands clear of its surroundings, so that its place proves nothing"
    parts = [
        f"{share:.0%} {what}"
        for share, what in (
            (seen.free, "free space"),
            (seen.objects, "an object's surface"),
            (seen.structure, "the room's surface"),
            (seen.unseen, "not looked at"),
        )
        if share >= 0.005
    ]
    by = "the first map" if change.id_a is None else "the second map"
    return f"{by} saw in its place: {', '.join(parts) or 'nothing that counts'}"


def changes_text(found: MapChanges) -> str:
    """Return a line for each object, and the counts."""
    width = max((len(change.verdict) for change in found.changes), default=0)
    lines = [f"{change.verdict:<{width}}  {sentence(change)}; {evidence_text(change)}" for change in found.changes]
    return "\n".join([*lines, count_text(found)])
