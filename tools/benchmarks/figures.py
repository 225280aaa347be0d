"""A measured figure, and how figures are printed and written."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hickory_stream.base.json_text import dumps

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """One measured number, or a name; a figure that could not be measured is absent, never NaN.

    `of` is its denominator in words, `left_out` what does not count and why, `interval` 95 % of where it may lie and
    `interval_by` how that was found; `role` says whether anything was chosen by what it was measured on.
    """

    name: str
    value: float | str
    unit: str
    better: Literal["higher", "lower", "same"]
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
    """What a benchmark may be told.

    `quick` asks for a smaller sample in under 50 s; `scenes` are truth folders to measure on instead of its own,
    `meshes` a folder of meshes, `clouds` one of labelled clouds; pictures go to `render`. What has many repetitions
    keeps them under `state` (not when quick), does those alone that `only` names, begins none after `minutes`, and
    forgets earlier ones when `fresh`. `worlds` is the folder of rooms that others made;
    `maps` asks for altered maps instead of damaged logs.
    """

    seed: int
    quick: bool
    scenes: tuple[Path, ...] = ()
    meshes: Path | None = None
    clouds: Path | None = None
    render: Path | None = None
    state: Path = Path("out/bench")
    only: tuple[str, ...] = ()
    minutes: float = math.inf
    fresh: bool = False
    worlds: Path | None = None
    maps: bool = False


def print_table(figures: list[Figure]) -> None:
    """Print the figures as a table."""
    width = max((len(figure.name) for figure in figures), default=4)
    for figure in figures:
        value = f"{figure.value:>12}" if isinstance(figure.value, str) else f"{figure.value:>12.4g}"
        told = [] if figure.better == "same" else [f"({figure.better} is better)"]
        if figure.interval is not None:
            told.append(f"[{figure.interval[0]:.3f}, {figure.interval[1]:.3f}] {figure.interval_by}")
        told += [text for text in (figure.of, figure.role) if text]
        if figure.left_out:
            told.append(f"left out: {figure.left_out}")
        print(f"{figure.name:<{width}}  {value} {figure.unit:<8} {'; '.join(told)}")


def write_json(figures: list[Figure], path: Path) -> None:
    """Write the figures as a list of records."""
    path.write_text(dumps(records_of(figures), indent=1) + "\n")


def records_of(figures: Sequence[Figure]) -> list[dict[str, object]]:
    """Return the figures as JSON."""
    return [_record(figure) for figure in figures]


def _record(figure: Figure) -> dict[str, object]:
    """Return a figure as JSON: its name, value, unit and direction, and what else is said of it."""
    always = ("name", "value", "unit", "better")
    return {key: value for key, value in dataclasses.asdict(figure).items() if key in always or value}
