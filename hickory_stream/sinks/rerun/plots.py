"""Plots of a report's numbers, and the log of its decisions."""

import textwrap
from collections import Counter
from typing import Any

import rerun as rr

from hickory_stream.geometry.display import color_of_id, readable_on_dark
from hickory_stream.records import Decision, FrameReport, Phase, View
from hickory_stream.sinks.rerun.items import LogItem, Span

# Every decision is logged under its kind; one that is about an object also under that object, to be read by itself:
# a merge under both, so that what is gone says what it became.
PLOTS, DECISIONS, OBJECT_DECISIONS = "plots", "decisions", "decisions_of"
# The groups of curves that there is one of per object, and what they show: S = ln(1 + sigma^2) R_area^a R_depth^b.
_PER_OBJECT = {"score": "S", "variance": "sigma^2", "area": "R_area", "depth": "R_depth"}
# What changes which objects there are; all else is for those who ask.
_CHANGES = ("merge", "split", "part", "drop", "room", "trim", "loop", "pose_correction")
_JUMPS = ("time_jump", "pose_jump", "keep_out", "floor")
# The viewer cuts a text at the edge of its view: a longer one is continued in another row.
_LINE_LENGTH = 160


class Plots:
    """Turns metrics into scalars; a curve gets its name and colour with its first value."""

    def __init__(self) -> None:
        self._named: set[str] = set()
        self._best: dict[int, View | None] = {}

    def items(self, report: FrameReport) -> list[LogItem]:
        """Return the scalars of a report's metrics, and the number of objects in each phase."""
        metrics = list(report.metrics)
        if report.snapshot is not None:
            phases = Counter(o.phase for o in report.snapshot.objects)
            metrics += [(f"objects/{phase}", float(phases[phase])) for phase in Phase]
            before, self._best = self._best, {seen.id: seen.best_view for seen in report.snapshot.objects}
            for object_id, view in self._best.items():
                if view is not before.get(object_id):
                    metrics += _factors(object_id, view)
        items = []
        for name, value in metrics:
            path = f"{PLOTS}/{name}"
            if name not in self._named:
                self._named.add(name)
                items.append(LogItem(path=path, archetypes=(_curve(name),), span=Span.STATIC))
            items.append(LogItem(path=path, archetypes=(rr.Scalars(value),)))
        return items


def decision_items(decisions: tuple[Decision, ...]) -> list[LogItem]:
    """Return the decisions as text by kind and by object, in the colour of the object."""
    items = []
    for decision in decisions:
        about = decision.object_id
        paths = [f"{DECISIONS}/{decision.kind}"]
        paths += [f"{OBJECT_DECISIONS}/{i}" for i in (about, decision.other_id) if i is not None]
        color = None if about is None else readable_on_dark(color_of_id(about))
        for line in textwrap.wrap(_sentence(decision), _LINE_LENGTH, subsequent_indent="    "):
            text = rr.TextLog(line, level=_level(decision), color=color)
            items += [LogItem(path=path, archetypes=(text,)) for path in paths]
    return items


def _level(decision: Decision) -> Any:
    if decision.kind in _JUMPS:
        return rr.TextLogLevel.WARN
    is_confirmed = decision.kind == "phase" and decision.text.startswith(Phase.TENTATIVE)
    return rr.TextLogLevel.INFO if is_confirmed or decision.kind in _CHANGES else rr.TextLogLevel.DEBUG


def _factors(object_id: int, view: View | None) -> list[tuple[str, float]]:
    if view is None or view.variance is None:
        return []
    return [
        (f"variance/{object_id}", view.variance),
        (f"area/{object_id}", view.r_area),
        (f"depth/{object_id}", view.r_depth),
    ]


def _sentence(decision: Decision) -> str:
    about = "" if decision.object_id is None else f"#{decision.object_id} "
    return f"{about}{decision.kind}: {decision.text}"


def _curve(name: str) -> rr.SeriesLines:
    group, _, last = name.rpartition("/")
    if group in _PER_OBJECT and last.isdecimal():
        return rr.SeriesLines(names=f"{_PER_OBJECT[group]} of #{last}", colors=color_of_id(int(last)), widths=1.5)
    return rr.SeriesLines(names=last, widths=1.5)
