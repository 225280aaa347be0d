"""Figures: measured numbers with their denominators, printed as a table and written as JSON."""

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from hickory_stream.base.json_text import dumps
from tools.benchmarks.common.intervals import bootstrap, wilson

Better = Literal["higher", "lower", "same"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """One measured number, or a name; a figure that could not be measured is absent, never NaN."""

    # `of` is its denominator in words, `left_out` the rest with the reason, `interval` its 95 % confidence interval by
    # the method `interval_by`; `role` says whether anything was tuned on its data.

    name: str
    value: float | str
    unit: str = ""
    better: Better = "higher"
    of: str = ""
    left_out: str = ""
    interval: tuple[float, float] | None = None
    interval_by: str = ""
    role: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.value, str) and not math.isfinite(self.value):
            raise ValueError(f"{self.name} is {self.value}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Options:
    """The options of a benchmark, as `tools/bench --help` explains them."""

    seed: int
    quick: bool
    scenes: tuple[Path, ...] = ()
    meshes: Path | None = None
    state: Path = Path("out/bench")
    only: tuple[str, ...] = ()
    minutes: float = math.inf
    fresh: bool = False
    worlds: Path | None = None
    maps: bool = False


def figure(name: str, value: Any, unit: str = "", better: Any = "higher", of: str = "", **more: Any) -> Figure:
    number = value if isinstance(value, str) else float(value)
    return Figure(name=name, value=number, unit=unit, better=better, of=of, **more)


def share(name: str, found: float, total: int, of: str, better: Better = "higher", **more: Any) -> list[Figure]:
    if not total:
        return []
    interval = {"interval": wilson(int(found), total), "interval_by": "Wilson"}
    return [figure(name, found / total, "", better, f"{int(found)} of {total} {of}", **interval, **more)]


def mean(
    name: str, values: ArrayLike, unit: str, better: Better, of: str, *, statistic: Callable[[Any], Any] = np.mean,
    interval_by: str = "bootstrap", **more: Any,
) -> Figure:  # fmt: skip
    rows = np.asarray(values, dtype=np.float64)
    interval = bootstrap([rows], lambda groups: float(statistic(groups[0])))
    return figure(name, statistic(rows), unit, better, of, interval=interval, interval_by=interval_by, **more)


def print_table(figures: Sequence[Figure]) -> None:
    width = max((len(one.name) for one in figures), default=4)
    for one in figures:
        value = f"{one.value:>12}" if isinstance(one.value, str) else f"{one.value:>12.4g}"
        notes = [] if one.better == "same" else [f"({one.better} is better)"]
        if one.interval is not None:
            notes.append(f"[{one.interval[0]:.3f}, {one.interval[1]:.3f}] {one.interval_by}")
        notes += [text for text in (one.of, one.role, one.left_out and f"left out: {one.left_out}") if text]
        print(f"{one.name:<{width}}  {value} {one.unit:<8} {'; '.join(notes)}")


def write_json(figures: Sequence[Figure], path: Path) -> None:
    path.write_text(dumps(records_of(figures), indent=1) + "\n")


def records_of(figures: Sequence[Figure]) -> list[dict[str, object]]:
    """Return the figures as JSON; empty notes are left out."""
    always = ("name", "value", "unit", "better")
    return [{key: value for key, value in dataclasses.asdict(one).items() if key in always or value} for one in figures]
