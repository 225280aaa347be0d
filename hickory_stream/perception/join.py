"""Joining fragments into things: along their seams, planes with their legs, and what would fall with what holds it.

The order is fixed (seams, what goes on behind something, legs, floating pieces by rounds), and within each step only
the set of pairs counts.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.floating import FloatConfig, Loose, holders
from hickory_stream.perception.hidden import HiddenConfig, bridges
from hickory_stream.perception.pieces import measure
from hickory_stream.perception.rules import (
    RuleConfig,
    Scene,
    bare_planes,
    carriers,
    is_back,
    is_one_thing,
    legs,
    seats,
)
from hickory_stream.perception.seams import contacts_of, seams_of
from hickory_stream.perception.standing import standing_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface


@dataclass(frozen=True, kw_only=True, slots=True)
class JoinConfig:
    """How fragments are joined.

    Attributes:
        reach_px: pixels are neighbours across fewer than this many pixels without a label.
    """

    rules: RuleConfig = field(default_factory=RuleConfig)
    floating: FloatConfig = field(default_factory=FloatConfig)
    hidden: HiddenConfig = field(default_factory=HiddenConfig)
    reach_px: int = 3


class Groups:
    """A partition of labels 0..n - 1 that only grows coarser; a group is named by its lowest label."""

    def __init__(self, count: int) -> None:
        self._parent = list(range(count))

    def unite(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Make one group of the groups of each pair."""
        for a, b in pairs:
            ra, rb = self._root(a), self._root(b)
            self._parent[max(ra, rb)] = min(ra, rb)

    def roots(self) -> NDArray[np.int64]:
        """Return (n,) the name of each label's group."""
        return np.array([self._root(i) for i in range(len(self._parent))])

    def numbers(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (n,) the groups numbered without gaps in the order of their names, and the names (groups,)."""
        names, numbers = np.unique(self.roots(), return_inverse=True)
        return numbers, names

    def _root(self, i: int) -> int:
        while self._parent[i] != i:
            i = self._parent[i]
        return i


def join_fragments(
    surface: Surface,
    labels: NDArray[np.int32],
    supports: NDArray[np.int32],
    areas_m2: NDArray[np.float32],
    structure: NDArray[np.bool_],
    floor_z_m: float | None,
    config: JoinConfig,
) -> NDArray[np.int32]:
    """Return (h, w) instance labels 1..n: joined fragments, numbered in the order of their first fragment."""
    count = int(labels.max()) + 1
    if count == 1:
        return labels
    level = (surface.normals_world[..., 2] > 0.7) | (supports > 0)
    heights = surface.points_world[..., 2]
    contacts = contacts_of(surface, np.where(structure, np.int32(count), labels), config.reach_px)
    pieces = measure(surface, labels, supports, areas_m2)
    scene = Scene(
        surface=surface,
        labels=labels,
        pieces=pieces,
        standing=standing_of(contacts, np.arange(count + 1), heights, level),
        is_seat=seats(pieces, floor_z_m, config.rules),
    )
    groups = Groups(count)
    seams = seams_of(surface, contacts, count)
    groups.unite((seam.a, seam.b) for seam in seams if is_one_thing(scene, seam, config.rules))
    # By groups: the top of a box is a fragment of its own where it is a supporting plane.
    numbers, first = groups.numbers()
    hidden = bridges(surface, numbers.astype(np.int32)[labels], config.hidden)
    groups.unite((int(first[a]), int(first[b])) for a, b in hidden)
    groups.unite(legs(scene, contacts, groups.roots(), config.rules))
    is_bare = bare_planes(pieces, groups.roots(), config.rules)
    groups.unite((seam.a, seam.b) for seam in seams if is_back(scene, seam, is_bare, config.rules))
    is_carrier = carriers(scene, config.rules)
    for _ in range(config.floating.rounds):
        numbers, first = groups.numbers()
        joined = numbers.astype(np.int32)[labels]
        pieces = measure(surface, joined, supports, areas_m2)
        loose = Loose(
            groups=joined,
            pieces=pieces,
            standing=standing_of(contacts, np.append(numbers, len(first)), heights, level),
            carries=np.bincount(numbers, weights=is_carrier, minlength=len(first)) > 0,
            is_seat=seats(pieces, floor_z_m, config.rules),
        )
        pairs = holders(surface, loose, config.floating)
        if not pairs:
            break
        groups.unite((int(first[i]), int(first[j])) for i, j in pairs)
    return groups.numbers()[0].astype(np.int32)[labels]
