"""Plots of a report's numbers, and the log of its decisions."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import rerun as rr

from hickory_stream.geometry.palette import color_of_id
from hickory_stream.records import Phase
from hickory_stream.sinks.rerun_items import LogItem, Span

if TYPE_CHECKING:
    from hickory_stream.records import Decision, FrameReport, TrackedObject

PLOTS, DECISIONS = "plots", "decisions"
# The groups of curves that there is one of per object, and what they show: S = ln(1 + sigma^2) R_area^a R_depth^b.
_PER_OBJECT = {"score": "S", "variance": "sigma^2", "area": "R_area", "depth": "R_depth"}
_LEVELS = {
    "associate": rr.TextLogLevel.DEBUG,
    "view": rr.TextLogLevel.DEBUG,
    "reject": rr.TextLogLevel.WARN,
    "drop": rr.TextLogLevel.WARN,
}


class Plots:
    """Turns metrics into scalars; a curve gets its name and colour when it first appears."""

    def __init__(self) -> None:
        self._named: set[str] = set()

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return the scalars of a report's metrics, and the number of objects in each phase."""
        metrics = list(report.metrics)
        if report.snapshot is not None:
            phases = Counter(o.phase for o in report.snapshot.objects)
            metrics += [(f"objects/{phase}", float(phases[phase])) for phase in Phase]
            for seen in report.snapshot.objects:
                metrics += _factors(seen)
        items = []
        for name, value in metrics:
            path = f"{PLOTS}/{name}"
            if name not in self._named:
                self._named.add(name)
                items.append(LogItem(path=path, archetypes=(_curve(name),), span=Span.STATIC))
            items.append(LogItem(path=path, archetypes=(rr.Scalars(value),)))
        return items


def decision_items(decisions: tuple[Decision, ...]) -> list[LogItem]:
    """Return one line of text per decision, coloured as the object that it is about."""
    return [
        LogItem(
            path=f"{DECISIONS}/{decision.kind}",
            archetypes=(
                rr.TextLog(
                    _sentence(decision),
                    level=_LEVELS.get(decision.kind, rr.TextLogLevel.INFO),
                    color=None if decision.object_id is None else color_of_id(decision.object_id),
                ),
            ),
        )
        for decision in decisions
    ]


def _factors(seen: TrackedObject) -> list[tuple[str, float]]:
    """Return the factors of S of an object's best view."""
    view = seen.best_view
    if view is None or view.variance is None:
        return []
    return [
        (f"variance/{seen.id}", view.variance),
        (f"area/{seen.id}", view.r_area),
        (f"depth/{seen.id}", view.r_depth),
    ]


def _sentence(decision: Decision) -> str:
    about = "" if decision.object_id is None else f" {decision.object_id}"
    return f"{decision.kind}{about}: {decision.text}"


def _curve(name: str) -> rr.SeriesLines:
    group, _, last = name.rpartition("/")
    if group in _PER_OBJECT and last.isdecimal():
        return rr.SeriesLines(names=f"{_PER_OBJECT[group]} of {last}", colors=color_of_id(int(last)), widths=1.5)
    return rr.SeriesLines(names=last, widths=1.5)
