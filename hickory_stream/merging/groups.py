"""Groups of maps that hang together: each group in the frame of its first map, found by the pose graph of `merge`.

Nothing is said of two groups: no alignment between them is believed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.answer import Alignment
from hickory_stream.merging.merge_maps import laid_out

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from hickory_stream.alignment.answer import NoAlignment
    from hickory_stream.records import MapSnapshot


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Group:
    """Maps in one frame: their indices in ascending order, group_from_map (4, 4) of each, and the pairs believed.

    The frame is that of the first map. A map that is alone is a group of its own, without pairs.
    """

    members: tuple[int, ...]
    group_from_map: tuple[NDArray[np.float64], ...]
    pairs: tuple[tuple[int, int], ...]


def groups_of(
    snapshots: Sequence[MapSnapshot], answers: Mapping[tuple[int, int], Alignment | NoAlignment]
) -> tuple[Group, ...]:
    """Return every map in exactly one group; `answers` by the pair (a, b), a < b, those that are missing join nothing.

    An alignment that the others contradict joins nothing: what hung on it alone is another group.
    """
    groups = []
    remaining = list(range(len(snapshots)))
    while remaining:
        group = _group_of(_connected(remaining, answers), snapshots, answers)
        groups.append(group)
        remaining = [i for i in remaining if i not in group.members]
    return tuple(groups)


def _connected(indices: Sequence[int], answers: Mapping[tuple[int, int], Alignment | NoAlignment]) -> list[int]:
    """Return which of the maps hang on the first of them by alignments, in ascending order."""
    reached, waiting = {indices[0]}, [indices[0]]
    while waiting:
        at = waiting.pop()
        for i in indices:
            if i not in reached and isinstance(answers.get((min(at, i), max(at, i))), Alignment):
                reached.add(i)
                waiting.append(i)
    return sorted(reached)


def _group_of(
    members: Sequence[int],
    snapshots: Sequence[MapSnapshot],
    answers: Mapping[tuple[int, int], Alignment | NoAlignment],
) -> Group:
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
