"""How many changes were found, and how many were said that never were: counts, their sum, and the figures of it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

from tools.benchmarks.figures import Figure
from tools.benchmarks.intervals import wilson

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True, slots=True)
class PairCounts:
    """What came of one pair of maps; changes are those of objects of which enough was seen.

    Of the verdicts that were `said` of objects that are true ones, `said_right` are right; `probability` is the sum of
    what was said to be their probability, and `brier` that of its squared distances from 1 where right, 0 where wrong.
    """

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
    """Return all counts together."""
    return PairCounts(**{field.name: sum(getattr(one, field.name) for one in pairs) for field in fields(PairCounts)})


def count_figures(total: PairCounts, prefix: str = "") -> list[Figure]:
    """Return the figures of counts, of those whose denominator is not zero; names begin with `prefix`."""
    found = [
        share(
            f"{prefix}changes_found_fraction", total.held_found, total.held, "changes among objects that the maps hold"
        ),
        share(
            f"{prefix}changes_found_of_all",
            total.found,
            total.changes,
            "changes, whether the maps hold the object or not",
        ),
        share(
            f"{prefix}changes_false_per_object",
            total.false_changes,
            total.objects,
            "objects that stayed",
            better="lower",
        ),
        share(
            f"{prefix}moved_as_moved_fraction",
            total.moved_as_moved,
            total.moved_held,
            "moved objects that both maps hold",
        ),
    ]
    return [figure for figure in found if figure is not None]


def calibration_figures(total: PairCounts) -> list[Figure]:
    """Return by how much probabilities are too high, and Brier's score; nothing where nothing was said."""
    if not total.said:
        return []
    right = total.said_right / total.said
    low, high = wilson(total.said_right, total.said)
    sure = total.probability / total.said
    of = f"{total.said} verdicts of true objects, {right:.3f} of them right"
    return [
        Figure(
            name="changes_overconfidence", value=sure - right, unit="", better="lower", of=of,
            interval=(sure - high, sure - low), interval_by="Wilson",
        ),
        Figure(name="changes_brier", value=total.brier / total.said, unit="", better="lower", of=of),
    ]  # fmt: skip


def share(name: str, part: int, whole: int, of: str, better: str = "higher") -> Figure | None:
    """Return a share with its interval; None where there is nothing to have a share of."""
    if not whole:
        return None
    return Figure(
        name=name, value=part / whole, unit="", better="lower" if better == "lower" else "higher",
        of=f"{whole} {of}", interval=wilson(part, whole), interval_by="Wilson",
    )  # fmt: skip
