"""Groups of maps that hang together: each in the frame of its first map, found by the pose graph of `merge`."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment
from hickory_stream.merging.layout import Answers, laid_out
from hickory_stream.records import MapSnapshot

Pair = tuple[int, int]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Group:
    """Maps in the frame of the first: ascending indices, `group_from_map` (4, 4) of each, and the pairs believed."""

    members: tuple[int, ...]
    group_from_map: tuple[NDArray[np.float64], ...]
    pairs: tuple[tuple[int, int], ...]


def groups_of(snapshots: Sequence[MapSnapshot], answers: Answers) -> tuple[Group, ...]:
    """Return every map in exactly one group; `answers` by the pair (a, b), a < b, those that are missing join nothing.

    A contradicted alignment joins nothing. Where another one may as well be the wrong one, as in a ring that does not
    close, none of them joins anything.
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
    # Without the believed alignment no path joins the two maps of a rejected one.
    others = [other for other in believed if other != pair]
    return any(b not in _reached(a, others) for a, b in rejected)


def _connected(indices: Sequence[int], pairs: Collection[Pair]) -> list[int]:
    own = set(indices)
    return sorted(_reached(indices[0], [pair for pair in pairs if set(pair) <= own]))


def _reached(start: int, pairs: Collection[Pair]) -> set[int]:
    reached, is_growing = {start}, True
    while is_growing:
        new = {i for pair in pairs if reached & set(pair) for i in pair} - reached
        reached |= new
        is_growing = bool(new)
    return reached


def _group_of(members: Sequence[int], snapshots: Sequence[MapSnapshot], answers: Answers) -> Group:
    # All of the maps, less those that hang on rejected alignments.
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
