"""What changed between two truths of one world whose ids stay, as those of `worlds.days` do."""

from dataclasses import dataclass

import numpy as np

from hickory_stream.evaluation.truth import Truth

_SAME_M, _SAME_TURN = 0.01, 0.02


@dataclass(frozen=True, kw_only=True, slots=True)
class TrueChanges:
    """Ids of the objects that stayed, that were moved, that are gone and that are new, each sorted."""

    stayed: tuple[int, ...]
    moved: tuple[int, ...]
    gone: tuple[int, ...]
    new: tuple[int, ...]


def true_changes(a: Truth, b: Truth) -> TrueChanges:
    before = {item.id: item.world_from_object for item in a.objects}
    after = {item.id: item.world_from_object for item in b.objects}
    both = sorted(before.keys() & after.keys())
    moved = tuple(i for i in both if not _is_same(before[i], after[i]))
    gone, new = tuple(sorted(before.keys() - after.keys())), tuple(sorted(after.keys() - before.keys()))
    return TrueChanges(stayed=tuple(i for i in both if i not in moved), moved=moved, gone=gone, new=new)


def _is_same(one: np.ndarray, other: np.ndarray) -> bool:
    away = one[:3, 3] - other[:3, 3]
    return float(np.linalg.norm(away)) < _SAME_M and float(np.abs(one[:3, :3] - other[:3, :3]).max()) < _SAME_TURN
