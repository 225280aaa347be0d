"""Records of the changes of objects between two maps, and their texts."""

from dataclasses import dataclass
from enum import StrEnum
from math import hypot

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.records import ObjectKind, kind_text


class Verdict(StrEnum):
    """Change of an object from map a to map b.

    `NOT_SEEN_AGAIN`: map b did not observe its place; `NOT_SEEN_BEFORE`: map a did not. Neither means gone or new.
    """

    STILL_THERE = "still there"
    MOVED = "moved"
    GONE = "gone"
    NEW = "new"
    EXCHANGED = "exchanged"
    NOT_SEEN_AGAIN = "not seen again"
    NOT_SEEN_BEFORE = "not seen before"


@dataclass(frozen=True, kw_only=True, slots=True)
class Evidence:
    """Observations of the other map at an object's place: shares of its clear points, which add up to 1.

    `free`: rays passed; `structure` and `objects`: a surface of the room or of an object; `unseen`: not observed. All
    are 0 without clear points (`num_clear`).
    """

    free: float
    structure: float
    objects: float
    unseen: float
    num_clear: int


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectChange:
    """Change of one object, with its id in each map that has it, and the probability.

    `evidence` is from the other map; of a pair, from map b at the place of map a's object. `shift_m` is the motion of a
    moved object's centre in the frame of map a. `kind` is from map b, if it has the object.
    """

    verdict: Verdict
    id_a: int | None
    id_b: int | None
    probability: float
    evidence: Evidence
    shift_m: tuple[float, float, float] | None = None
    kind: ObjectKind = ObjectKind.OBJECT
    fixture_probability: float = 0.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class MapChanges:
    """Changes of all objects of two maps by verdict, then id; `a_from_b` (4, 4) is the alignment."""

    a_from_b: NDArray[np.float64]
    sigma_m: float
    changes: tuple[ObjectChange, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class ChangesConfig(Ranged):
    """When an object is said to have changed.

    Attributes:
        near_m: a point lies on a surface that is at most this far, and twice the alignment's uncertainty, away.
        most_near_m: ... but at most this far, however uncertain the alignment is.
        min_overlap: two objects are in one place if their boxes share this much (intersection over union), or if this
            share of each one's points lies on the other.
        moved_m: an object in the same place has moved if its centre is farther away than this ...
        moved_free: ... and at least this share of its clear points is free space by now.
        change_prior: the probability that an object is removed, moved or added from one map to the next.
        looks: as how many independent looks all clear points of an object count: what is wrong with one is often wrong
            with its neighbour.
        reliable: the probability that one look is right.
        min_probability: what is less probable is left unknown.
        min_free: share of the clear points that must be free space before anything is called gone, or new.
        size_sigma, color_sigma: two sightings of one object differ by this in the logarithm of its sides, and in CIE
            Lab.
        look_floor: any two objects look alike to this degree by chance.
        alike: the probability of being the same by its looks from which a new object is one that moved.
        unlike: the degree of likeness in colour and feature below which what is in one place was exchanged.
    """

    near_m: float = number(0.04, 0, 1, "m")
    most_near_m: float = number(0.12, 0, 1, "m")
    min_overlap: float = number(0.25, 0, 1, "share")
    moved_m: float = number(0.12, 0, 10, "m")
    moved_free: float = number(0.3, 0, 1, "share")
    change_prior: float = number(0.1, 0, 1, "probability")
    looks: float = number(6.0, 1, 1000, "looks")
    reliable: float = number(0.86, 0.5, 1, "probability")
    min_probability: float = number(0.8, 0.5, 1, "probability")
    min_free: float = number(0.4, 0, 1, "share")
    size_sigma: float = number(0.25, 0.001, 10, "ratio")
    color_sigma: float = number(12.0, 0.1, 1000, "CIE Lab")
    look_floor: float = number(0.1, 1e-6, 1, "degree")
    alike: float = number(0.7, 0, 1, "probability")
    unlike: float = number(0.08, 0, 1, "degree")


def count_text(found: MapChanges) -> str:
    """Return the number of objects by verdict, and the quality of the alignment."""
    counts = [(verdict, sum(change.verdict is verdict for change in found.changes)) for verdict in Verdict]
    text = ", ".join(f"{count} {verdict}" for verdict, count in counts if count) or "no objects"
    return f"{text}; the maps are aligned to within {100 * found.sigma_m:.1f} cm"


def sentence(change: ObjectChange) -> str:
    """Return the change of one object as text."""
    name = " -> ".join(f"#{i}" for i in (change.id_a, change.id_b) if i is not None)
    name += f" ({kind_text(change.fixture_probability)})"
    if change.shift_m is not None:
        x, y, z = change.shift_m
        name += f" by {hypot(x, y, z):.2f} m ({x:+.2f}, {y:+.2f}, {z:+.2f})"
    return f"{name}, probability {change.probability:.2f}"


def evidence_text(change: ObjectChange) -> str:
    """Return the observations of the other map at an object's place as text."""
    seen = change.evidence
    if not seen.num_clear:
        return "nothing of it stands clear of its surroundings, so that its place proves nothing"
    parts = [
        f"{share:.0%} {what}"
        for share, what in (
            (seen.free, "free space"),
            (seen.objects, "an object's surface"),
            (seen.structure, "the room's surface"),
        )
        if share >= 0.005
    ]
    by = "the first map" if change.id_a is None else "the second map"
    if seen.unseen >= 0.995:
        return f"{by} did not see its place"
    parts += [f"{seen.unseen:.0%} of it was not seen"] * (seen.unseen >= 0.005)
    return f"{by} saw in its place: {', '.join(parts) or 'nothing that counts'}"


def changes_text(found: MapChanges) -> str:
    """Return a line for each object, and the counts."""
    width = max((len(change.verdict) for change in found.changes), default=0)
    lines = [f"{change.verdict:<{width}}  {sentence(change)}; {evidence_text(change)}" for change in found.changes]
    return "\n".join([*lines, count_text(found)])
