"""Clusters of objects of several maps that are one object: paired by alignments, or in one place after placing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

Member = tuple[int, int]
"""The index of a map, and the id of an object in it."""

_NEAR_M, _SAMPLE = 0.03, 400


@dataclass(frozen=True, kw_only=True, slots=True)
class Pairing:
    """Two objects that an alignment found to be one, and how far apart their centroids were left."""

    a: Member
    b: Member
    residual_m: float


def clusters_of(
    members: Sequence[Member], pairings: Sequence[Pairing], places: Mapping[Member, NDArray[np.float32]], share: float
) -> list[tuple[Member, ...]]:
    """Return the members in groups, each one object: at most one of each map; groups and members in ascending order.

    Args:
        members: all objects.
        pairings: what alignments say; the closest are joined first.
        places: the points (N, 3) of each object, in one frame.
        share: two objects of different maps that share this much of the smaller one's surface are one, too.
    """
    group_of: dict[Member, set[Member]] = {member: {member} for member in members}
    for pairing in sorted(pairings, key=lambda one: (one.residual_m, one.a, one.b)):
        _join(group_of, pairing.a, pairing.b)
    for a, b, _ in sorted(_coincident(members, places, share), key=lambda found: (-found[2], found[0], found[1])):
        _join(group_of, a, b)
    unique = {id(group): tuple(sorted(group)) for group in group_of.values()}
    return sorted(unique.values())


def _join(group_of: dict[Member, set[Member]], a: Member, b: Member) -> None:
    one, other = group_of[a], group_of[b]
    maps = [member[0] for member in one | other]
    if one is not other and len(maps) == len(set(maps)):
        one |= other
        for member in other:
            group_of[member] = one


def _coincident(
    members: Sequence[Member], places: Mapping[Member, NDArray[np.float32]], share: float
) -> list[tuple[Member, Member, float]]:
    """Return the pairs of different maps whose surfaces meet, with the share of the smaller one's that does."""
    known = [member for member in members if len(places[member])]
    low = np.array([places[member].min(axis=0) for member in known]).reshape(-1, 3) - _NEAR_M
    high = np.array([places[member].max(axis=0) for member in known]).reshape(-1, 3) + _NEAR_M
    trees = [cKDTree(places[member].astype(np.float64)) for member in known]
    found = []
    for i in range(len(known)):
        for j in np.flatnonzero(((low <= high[i]) & (high >= low[i])).all(axis=1)):
            if j > i and known[i][0] != known[j][0]:
                met = min(_met(places[known[i]], trees[j]), _met(places[known[j]], trees[i]))
                larger = max(_met(places[known[i]], trees[j]), _met(places[known[j]], trees[i]))
                if larger >= share and met >= share / 2:
                    found.append((known[i], known[j], met + larger))
    return found


def _met(points: NDArray[np.float32], tree: cKDTree) -> float:
    """Return the share of points that lie on the other surface."""
    sample = points[:: max(1, len(points) // _SAMPLE)].astype(np.float64)
    distances, _ = tree.query(sample, distance_upper_bound=_NEAR_M)
    return float(np.isfinite(distances).mean())
