"""Groups of maps that hang together: each group in the frame of its first map, found by the pose graph of `merge`.

Nothing is said of two groups: no alignment between them is believed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.answer import Alignment
from hickory_stream.merging.layout import laid_out

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from hickory_stream.merging.layout import Answers
    from hickory_stream.records import MapSnapshot

    Pair = tuple[int, int]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Group:
    """Maps in one frame: their indices in ascending order, group_from_map (4, 4) of each, and the pairs believed.

    The frame is that of the first map. A map that is alone is a group of its own, without pairs.
    """

    members: tuple[int, ...]
    group_from_map: tuple[NDArray[np.float64], ...]
    pairs: tuple[tuple[int, int], ...]


def groups_of(snapshots: Sequence[MapSnapshot], answers: Answers) -> tuple[Group, ...]:
    """Return every map in exactly one group; `answers` by the pair (a, b), a < b, those that are missing join nothing.

    An alignment that the others contradict joins nothing: what hung on it alone is another group. Where it is as likely
    that one of the others is the wrong one, as in a ring that does not close, none of them joins anything.
    """
    known = {pair: answer for pair, answer in answers.items() if isinstance(answer, Alignment)}
    groups: list[Group] = []
    remaining = list(range(len(snapshots)))
    while remaining:
        members = _connected(remaining, known)
        group = _group_of(members, snapshots, known)
        rejected = [pair for pair in known if set(pair) <= set(group.members) and pair not in group.pairs]
        disputed = [pair for pair in group.pairs if _disputes(pair, group.pairs, rejected)]
        if disputed:
            known = {pair: answer for pair, answer in known.items() if pair not in (*rejected, *disputed)}
            continue
        groups.append(group)
        remaining = [i for i in remaining if i not in group.members]
    return tuple(groups)


def _disputes(pair: Pair, believed: Sequence[Pair], rejected: Sequence[Pair]) -> bool:
    """Return whether a believed alignment is all that stands against a rejected one: without it the two agree."""
    others = [other for other in believed if other != pair]
    return any(b not in _reached(a, others) for a, b in rejected)


def _connected(indices: Sequence[int], pairs: Collection[Pair]) -> list[int]:
    """Return which of the maps hang on the first of them by alignments, in ascending order."""
    own = set(indices)
    return sorted(_reached(indices[0], [pair for pair in pairs if set(pair) <= own]))


def _reached(start: int, pairs: Collection[Pair]) -> set[int]:
    """Return the maps that pairs lead to from one of them, itself included."""
    reached, is_growing = {start}, True
    while is_growing:
        new = {i for pair in pairs if reached & set(pair) for i in pair} - reached
        reached |= new
        is_growing = bool(new)
    return reached


def _group_of(members: Sequence[int], snapshots: Sequence[MapSnapshot], answers: Answers) -> Group:
    """Return the group of the first of these maps: all of them, less what hangs on alignments that are rejected."""
    if len(members) == 1:
        return Group(members=(members[0],), group_from_map=(np.eye(4),), pairs=())
    own = {
        (i, j): answers[a, b]
        for i, a in enumerate(members)
        for j, b in enumerate(members)
        if i < j and (a, b) in answers
    }
    poses, outcomes = laid_out([snapshots[i] for i in members], own)
    placed = [(member, pose) for member, pose in zip(members, poses, strict=True) if pose is not None]
    return Group(
        members=tuple(member for member, _ in placed),
        group_from_map=tuple(pose for _, pose in placed),
        pairs=tuple((members[pair.a], members[pair.b]) for pair in outcomes if pair.is_believed),
    )
