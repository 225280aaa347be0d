"""The tables of figures in the READMEs, filled from what was measured last: `tools/bench NAME --write-docs`.

A table stands between `<!-- figures: NAME -->` and `<!-- end of figures -->`. A row says in its first column what a
figure means, with its name in backticks, and has goals in the columns between; the last column, and the line under the
table, are written from `measured/NAME.json`: when and at which commit that was, and whether the code is another by now.
With `<!-- figures: NAME, goals -->` the whole table is written: every figure for which the baseline has a goal.
"""

from __future__ import annotations

import json
import os
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.json_text import dumps
from tools.benchmarks.baseline import baseline_file, read_baseline
from tools.benchmarks.figures import records_of
from tools.benchmarks.processes import ROOT
from tools.benchmarks.repetitions import commit_of_the_code, product_hash

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from tools.benchmarks.figures import Figure

MEASURED = Path(__file__).parent / "measured"
_BLOCK = re.compile(
    r"(<!-- figures: (?P<name>\w+)(?P<goals>, goals)? -->\n)(?P<body>.*?)(\n?<!-- end of figures -->)", re.DOTALL
)
_OLDER = " **The code has changed since.**"
_NEVER = "*Typed before measurements were kept: older than the code. `tools/bench {name} --write-docs` measures it.*"
_NONE = "*No measurement is kept yet: `tools/bench {name} --write-docs` makes one.*"
_ABSENT = "not measured"


@dataclass(frozen=True, kw_only=True, slots=True)
class Measured:
    """What was measured last: `values` by name, each as it is shown.

    `code` is the hash of the packages then, `load` how many processes wanted a processor, the measured ones included.
    """

    values: Mapping[str, str]
    commit: str
    date: str
    code: str
    load: float
    is_quick: bool


def keep(name: str, figures: Sequence[Figure], *, is_quick: bool, folder: Path = MEASURED) -> None:
    """Write what a benchmark measured just now, with the commit, the date and the hash of the code."""
    folder.mkdir(exist_ok=True)
    about = {"commit": commit_of_the_code(), "date": datetime.now(tz=UTC).date().isoformat(), "code": product_hash()}
    load = round(os.getloadavg()[0], 1)
    content = {**about, "load": load, "is_quick": is_quick, "figures": records_of(figures)}
    (folder / f"{name}.json").write_text(dumps(content, indent=1) + "\n", encoding="utf-8")


def read_measured(name: str, folder: Path = MEASURED) -> Measured | None:
    """Return what a benchmark measured last; None where nothing was kept."""
    path = folder / f"{name}.json"
    if not path.is_file():
        return None
    content = json.loads(path.read_text(encoding="utf-8"))
    values = {entry["name"]: _shown(entry) for entry in content["figures"]}
    about = {key: content[key] for key in ("commit", "date", "code", "load", "is_quick")}
    return Measured(values=values, **about)


def write_docs(folder: Path = MEASURED) -> list[Path]:
    """Fill the tables of all READMEs; return those that have changed."""
    changed = []
    code = product_hash()
    for readme in readmes():
        text = readme.read_text(encoding="utf-8")
        filled = filled_in(text, folder=folder, code=code)
        if filled != text:
            readme.write_text(filled, encoding="utf-8")
            changed.append(readme)
    return changed


def readmes() -> Iterator[Path]:
    """Yield the README of the project and those beside the code."""
    yield ROOT / "README.md"
    for package in ("hickory_stream", "players", "tools"):
        yield from sorted((ROOT / package).rglob("README.md"))


def filled_in(text: str, *, folder: Path, code: str) -> str:
    """Return a text with its tables filled; `code` is the hash of the packages now."""

    def fill(block: re.Match[str]) -> str:
        name = block["name"]
        measured = read_measured(name, folder)
        body = block["body"]
        lines = [line for line in body.splitlines() if line.startswith("|")]
        if block["goals"]:
            lines = _table_of_goals(name, measured) if measured is not None else []
        elif measured is not None:
            lines = lines[:2] + [_row(line, measured.values) for line in lines[2:]]
        caption = _NEVER.format(name=name) if measured is None else _caption(name, measured, code)
        if block["goals"] and measured is None:
            caption = _NONE.format(name=name)
        return block[1] + "\n".join([*lines, *([""] if lines else []), caption, "<!-- end of figures -->"])

    return _BLOCK.sub(fill, text)


def without_age(text: str) -> str:
    """Return a text without what it says of the age of its figures: that changes with every change of the code."""
    return text.replace(_OLDER, "")


def _caption(name: str, measured: Measured, code: str) -> str:
    quick = " --quick" if measured.is_quick else ""
    told = (
        f"*`tools/bench {name}{quick}`, {measured.date}, commit {measured.commit}, under a load of {measured.load:g}.*"
    )
    return told + (_OLDER if measured.code != code else "")


def _row(line: str, values: Mapping[str, str]) -> str:
    """Return a row with its last cell filled: the values of the figures that its first cell names, in their order."""
    cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
    named = re.findall(r"`(\w+)`", cells[0])
    found = [values[name] for name in named if name in values]
    return "| " + " | ".join([*cells[:-1], ", ".join(found) or _ABSENT]) + " |"


def _table_of_goals(name: str, measured: Measured) -> list[str]:
    path = baseline_file(name)
    goals = {key: entry["goal"] for key, entry in read_baseline(path)["figures"].items()} if path.is_file() else {}
    rows = [
        f"| `{key}` | {goal:g} | {measured.values.get(key, _ABSENT)} |"
        for key, goal in goals.items()
        if isinstance(goal, int | float)
    ]
    return ["| figure | goal | measured |", "|---|---|---|", *rows]


def _shown(entry: Mapping[str, Any]) -> str:
    """Return a figure as a reader wants it: three digits, its unit, its interval."""
    value = entry["value"]
    if isinstance(value, str):
        return value
    size = abs(value)
    told = f"{value / 1e6:.3g} million" if size >= 1e6 else f"{value:,.0f}" if size >= 1000 else f"{value:.3g}"
    unit = {"": "", "1/s": " a second"}.get(entry["unit"], f" {entry['unit']}")
    interval = entry.get("interval")
    return told + unit + (f" ({interval[0]:.2f} to {interval[1]:.2f})" if interval else "")
