"""A measured figure, and how figures are printed and written."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from hickory_stream.json_text import dumps


@dataclass(frozen=True, kw_only=True, slots=True)
class Figure:
    """One measured number; a figure that could not be measured is absent, never NaN."""

    name: str
    value: float
    unit: str
    better: Literal["higher", "lower"]

    def __post_init__(self) -> None:
        if not math.isfinite(self.value):
            raise ValueError(f"{self.name} is {self.value}")


@dataclass(frozen=True, kw_only=True, slots=True)
class Options:
    """What a benchmark may be told.

    `quick` asks for a smaller sample in under 50 s; `scenes` are truth folders to measure on instead of its own,
    `meshes` a folder of meshes, `clouds` one of labelled clouds; pictures go to `render`. What has many repetitions
    keeps them under `state` (not when quick), does those alone that `only` names, begins none after `minutes`, and
    forgets earlier ones when `fresh`.
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


def print_table(figures: list[Figure]) -> None:
    """Print the figures as a table."""
    width = max((len(figure.name) for figure in figures), default=4)
    for figure in figures:
        print(f"{figure.name:<{width}}  {figure.value:>12.4g} {figure.unit:<8} ({figure.better} is better)")


def write_json(figures: list[Figure], path: Path) -> None:
    """Write the figures as a list of records."""
    path.write_text(dumps([dataclasses.asdict(figure) for figure in figures], indent=1) + "\n")
