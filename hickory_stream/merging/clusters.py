"""Clusters of objects of several maps that are one object: paired by alignments, or in one place after placing.

A map may have several things as one, e.g. a shelf and the dresser before it. None of the objects that lie on it in
another map is it, unless their boxes agree.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hickory_stream.geometry.boxes import OrientedBox, box_iou

Member = tuple[int, int]
"""The index of a map, and the id of an object in it."""

_NEAR_M, _SAMPLE = 0.03, 400
# Objects of another map that lie on one object before it counts as several; two are what one thing may break into.
_SEVERAL = 3
# Boxes of one thing have at least this IoU.
_SAME_IOU = 0.3


@dataclass(frozen=True, kw_only=True, slots=True)
class Pairing:
    """Two objects that an alignment found to be one, and how far apart their centroids were left."""

    a: Member
    b: Member
    residual_m: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Place:
    """Where an object lies in the frame of all: its points (N, 3), and its box."""

    points: NDArray[np.float32]
    box: OrientedBox


@dataclass(frozen=True, kw_only=True, slots=True)
class _Meeting:
    # Two objects of different maps whose surfaces meet: shares of the points of each on the other; `iou` of their
    # boxes.
    a: Member
    b: Member
    of_a: float
    of_b: float
    iou: float


def clusters_of(
    members: Sequence[Member], pairings: Sequence[Pairing], places: Mapping[Member, Place], share: float
) -> list[tuple[Member, ...]]:
    """Return the members in groups, each one object: at most one of each map; groups and members in ascending order.

    Of `pairings` the closest are joined first; two objects that share `share` of the smaller surface are one, too.
    """
    meetings = _meetings(members, places)
    apart = _apart(meetings, share)
    group_of: dict[Member, set[Member]] = {member: {member} for member in members}
    for pairing in sorted(pairings, key=lambda one: (one.residual_m, one.a, one.b)):
        if (pairing.a, pairing.b) not in apart:
            _join(group_of, pairing.a, pairing.b)
    for found in sorted(meetings, key=lambda found: (-found.of_a - found.of_b, found.a, found.b)):
        if _is_same(found, share) and (found.a, found.b) not in apart:
            _join(group_of, found.a, found.b)
    unique = {id(group): tuple(sorted(group)) for group in group_of.values()}
    return sorted(unique.values())


def _join(group_of: dict[Member, set[Member]], a: Member, b: Member) -> None:
    one, other = group_of[a], group_of[b]
    maps = [member[0] for member in one | other]
    if one is not other and len(maps) == len(set(maps)):
        one |= other
        for member in other:
            group_of[member] = one


def _is_same(found: _Meeting, share: float) -> bool:
    less, more = sorted((found.of_a, found.of_b))
    return less >= share / 2 and (more >= share or found.iou >= _SAME_IOU)


def _apart(meetings: Sequence[_Meeting], share: float) -> set[tuple[Member, Member]]:
    # Pairs, either way round, in which one object has several things as one and the other is one of these.
    lying_on: dict[tuple[Member, int], int] = {}
    for found in meetings:
        for whole, part, met in ((found.a, found.b, found.of_b), (found.b, found.a, found.of_a)):
            if met >= share / 2:
                lying_on[whole, part[0]] = lying_on.get((whole, part[0]), 0) + 1
    pairs = [
        (found.a, found.b)
        for found in meetings
        if found.iou < _SAME_IOU
        and max(lying_on.get((found.a, found.b[0]), 0), lying_on.get((found.b, found.a[0]), 0)) >= _SEVERAL
    ]
    return {*pairs, *((b, a) for a, b in pairs)}


def _meetings(members: Sequence[Member], places: Mapping[Member, Place]) -> list[_Meeting]:
    known = [member for member in members if len(places[member].points)]
    low = np.array([places[member].points.min(axis=0) for member in known]).reshape(-1, 3) - _NEAR_M
    high = np.array([places[member].points.max(axis=0) for member in known]).reshape(-1, 3) + _NEAR_M
    trees = [cKDTree(places[member].points.astype(np.float64)) for member in known]
    found = []
    for i, a in enumerate(known):
        for j in np.flatnonzero(((low <= high[i]) & (high >= low[i])).all(axis=1)):
            b = known[j]
            if j > i and a[0] != b[0]:
                of_a, of_b = _met(places[a].points, trees[j]), _met(places[b].points, trees[i])
                if of_a or of_b:
                    iou = box_iou(places[a].box, places[b].box)
                    found.append(_Meeting(a=a, b=b, of_a=of_a, of_b=of_b, iou=iou))
    return found


def _met(points: NDArray[np.float32], tree: cKDTree) -> float:
    sample = points[:: max(1, len(points) // _SAMPLE)].astype(np.float64)
    distances, _ = tree.query(sample, distance_upper_bound=_NEAR_M)
    return float(np.isfinite(distances).mean())
