"""Changes that a comparison of maps reports, counted against the true ones, and the figures of the counts."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, fields

from tools.benchmarks.common.figures import Figure, figure, share
from tools.benchmarks.common.intervals import wilson
from tools.evaluation.true_changes import TrueChanges

Held = Mapping[int, int | None]
"""The object of a map by true object of which enough was seen; None: the map does not hold it."""


@dataclass(frozen=True, kw_only=True, slots=True)
class PairCounts:
    """Counts of one pair of maps, over the changes of objects of which enough was seen."""

    # Of the verdicts that were `said` about true objects, `said_right` are right; `probability` is the sum of their
    # probabilities, `brier` the sum of the squared distances of these from 1 where right, from 0 where wrong.

    changes: int = 0
    found: int = 0
    held: int = 0
    held_found: int = 0
    moved_held: int = 0
    moved_as_moved: int = 0
    objects: int = 0
    false_changes: int = 0
    gone: int = 0
    gone_but_unseen: int = 0
    aligned: int = 0
    said: int = 0
    said_right: int = 0
    probability: float = 0.0
    brier: float = 0.0


def sum_of(pairs: Sequence[PairCounts]) -> PairCounts:
    return PairCounts(**{field.name: sum(getattr(one, field.name) for one in pairs) for field in fields(PairCounts)})


def counts_of(
    true: TrueChanges, held: tuple[Held, Held], gone: Collection[int | None], moved: Mapping[int | None, int | None],
    new: Collection[int | None],
) -> PairCounts:  # fmt: skip
    """Return how reported changes compare with the true ones."""
    # `held`: object of the map by true object, before and after; `moved`: later map's objects by their earlier number.
    in_a, in_b = held
    pairs = [(in_a[i], in_b[i]) for i in true.moved if i in in_a and i in in_b]
    is_held = [None not in pair for pair in pairs]
    is_moved = [known and moved.get(a) == b for known, (a, b) in zip(is_held, pairs, strict=True)]
    rows = [
        (known, whole or (a in gone and b in new))
        for known, whole, (a, b) in zip(is_held, is_moved, pairs, strict=True)
    ]
    rows += [(in_a[i] is not None, in_a[i] in gone) for i in true.gone if i in in_a]
    rows += [(in_b[i] is not None, in_b[i] in new) for i in true.new if i in in_b]
    stayed = [i for i in true.stayed if in_a.get(i) is not None or in_b.get(i) is not None]
    named_a, named_b = {*gone, *moved} - {None}, {*new, *moved.values()} - {None}
    return PairCounts(
        changes=len(rows), found=sum(found for _, found in rows), held=sum(known for known, _ in rows),
        held_found=sum(known and found for known, found in rows), moved_held=sum(is_held), moved_as_moved=sum(is_moved),
        objects=len(stayed), false_changes=sum(in_a.get(i) in named_a or in_b.get(i) in named_b for i in stayed),
        gone=len(gone), aligned=1,
    )  # fmt: skip


def count_figures(total: PairCounts, prefix: str = "") -> list[Figure]:
    """Return the figures of counts, of those whose denominator is not zero; names begin with `prefix`."""
    held, every = "changes among objects that the maps hold", "changes, whether the maps hold the object or not"
    moved = "moved objects that both maps hold"
    return [
        *share(f"{prefix}changes_found_fraction", total.held_found, total.held, held),
        *share(f"{prefix}changes_found_of_all", total.found, total.changes, every),
        *share(f"{prefix}changes_false_per_object", total.false_changes, total.objects, "objects that stayed", "lower"),
        *share(f"{prefix}moved_as_moved_fraction", total.moved_as_moved, total.moved_held, moved),
    ]


def calibration_figures(total: PairCounts) -> list[Figure]:
    """Return by how much probabilities are too high, and Brier's score; nothing without verdicts."""
    if not total.said:
        return []
    right, sure = total.said_right / total.said, total.probability / total.said
    low, high = wilson(total.said_right, total.said)
    of, interval = f"{total.said} verdicts of true objects, {right:.3f} of them right", (sure - high, sure - low)
    return [
        figure("changes_overconfidence", sure - right, "", "lower", of, interval=interval, interval_by="Wilson"),
        figure("changes_brier", total.brier / total.said, "", "lower", of),
    ]
