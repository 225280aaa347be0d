"""The tables of figures in Markdown files, filled from kept measurements: `tools/bench NAME --write-docs`."""
# A table stands between `<!-- figures: NAME -->` and `<!-- end of figures -->`; backticks name a row's figure. The last
# column and the lines below come from `measured/NAME.json`; a comment in the first cell is the format of the last.
# `NAME, goals` writes the whole table; `by row`: the last cell of a row names its benchmark. Parts replace figures by
# name.

import functools
import json
import os
import re
import textwrap
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hickory_stream.base.json_text import dumps
from tools.benchmarks.common.baseline import baseline_file, read_baseline
from tools.benchmarks.common.code_hashes import commit_of_the_code
from tools.benchmarks.common.figures import Figure, records_of
from tools.benchmarks.common.processes import ROOT
from tools.readmes import READMES, filled

MEASURED = ROOT / "tools" / "benchmarks" / "measured"
_OPENING, _CLOSING = r"<!-- figures: (?P<name>by row|\w+)(?P<goals>, goals)? -->", "<!-- end of figures -->"
_OLDER = "\n**The code has changed since.**"
_OLDER_IN_A_ROW = ", **older than the code**"
_MOST_IN_A_CELL = 40
_NONE = "*No measurement is kept yet: `tools/bench {name} --write-docs` makes one.*"
_COMMENT = re.compile(r"<!-- (.*?) -->")
_ABSENT = "not measured"
_WIDTH = 120

CodeOf = Callable[[str, str], str]
"""The hash of the code that a benchmark depends on, by its name and the options of a run."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Run:
    """One run of a benchmark: its figures by name, formatted."""

    # `options` are the options of `tools/bench` that made it a part or a smaller sample, `code` is the hash of the code
    # that the benchmark depends on, `load` the number of processes that wanted a processor; None: unknown.

    values: Mapping[str, str]
    options: str
    commit: str
    date: str
    code: str
    load: float | None


def keep(
    name: str, figures: Sequence[Figure], *, options: str, code: str, folder: Path = MEASURED, **about: Any
) -> None:
    """Add the figures of a run to the kept ones; older figures of the same names are removed."""
    # `options` made the run a part or a smaller sample; `code` is the hash; `about`: commit, date, load, by default of
    # now.
    about = {
        "commit": commit_of_the_code(),
        "date": datetime.now(tz=UTC).date().isoformat(),
        "load": round(os.getloadavg()[0], 1),
    } | about
    path, names = folder / f"{name}.json", {figure.name for figure in figures}
    runs = json.loads(path.read_text(encoding="utf-8"))["runs"] if path.is_file() else []
    for run in runs:
        run["figures"] = [entry for entry in run["figures"] if entry["name"] not in names]
    runs.append({"options": options, "code": code, **about, "figures": records_of(figures)})
    folder.mkdir(exist_ok=True)
    path.write_text(dumps({"runs": [run for run in runs if run["figures"]]}, indent=1) + "\n", encoding="utf-8")


def read_measured(name: str, folder: Path = MEASURED) -> tuple[Run, ...]:
    """Return the kept runs of a benchmark, each figure in the last run that measured it."""
    path = folder / f"{name}.json"
    return tuple(
        Run(
            values={entry["name"]: _shown(entry) for entry in run["figures"]},
            **{key: run[key] for key in ("options", "commit", "date", "code", "load")},
        )
        for run in (json.loads(path.read_text(encoding="utf-8"))["runs"] if path.is_file() else [])
    )


def write_docs(code_of: CodeOf, folder: Path = MEASURED) -> list[Path]:
    """Fill the tables of all READMEs and results; return the files that have changed."""
    changed = []
    for readme in READMES:
        text = readme.read_text(encoding="utf-8")
        written = filled_in(text, folder=folder, code_of=code_of)
        if written != text:
            readme.write_text(written, encoding="utf-8")
            changed.append(readme)
    return changed


def filled_in(text: str, *, folder: Path, code_of: CodeOf) -> str:
    measured = functools.cache(functools.partial(read_measured, folder=folder))

    def write(block: re.Match[str]) -> str:
        name = block["name"]
        lines = [line for line in block["body"].splitlines() if line.startswith("|")]
        if name == "by row":
            rows = [_row_with_benchmark(line, measured(_benchmark_of(line)), code_of) for line in lines[2:]]
            return "\n".join([*lines[:2], *rows])
        runs = measured(name)
        if block["goals"]:
            lines = _table_of_goals(name, runs) if runs else []
        elif runs:
            lines = lines[:2] + [_row(line, runs) for line in lines[2:]]
        names = {figure for line in lines[2:] for figure in _named(line)}
        captions = _captions(name, runs, names, code_of) if runs else [_NONE.format(name=name)]
        return "\n".join([*lines, *([""] if lines else []), *captions])

    return filled(text, _OPENING, _CLOSING, write)


def without_age(text: str) -> str:
    """Return a text without its remarks on the age of figures, which change with the code."""
    return text.replace(_OLDER, "").replace(_OLDER_IN_A_ROW, "")


def _captions(name: str, runs: Sequence[Run], wanted: Collection[str], code_of: CodeOf) -> list[str]:
    used = [run for run in runs if not run.values.keys().isdisjoint(wanted)]
    lines = []
    for run in used:
        figures = ", ".join(f"`{figure}`" for figure in run.values if figure in wanted)
        load = f", under a load of {run.load:g}" if run.load is not None else ""
        about = f"`tools/bench {name}{run.options}`, {run.date}, commit {run.commit}{load}"
        line = f"*{about}.*" if len(used) == 1 else f"*{about}: {figures}.*"
        wrapped = textwrap.fill(line, _WIDTH, break_long_words=False, break_on_hyphens=False)
        lines.append(wrapped + (_OLDER if run.code != code_of(name, run.options) else ""))
    return lines


def _row(line: str, runs: Sequence[Run]) -> str:
    return _joined([*_cells(line)[:-1], _filled(line, runs)])


def _row_with_benchmark(line: str, runs: Sequence[Run], code_of: CodeOf) -> str:
    cells, name = _cells(line), _benchmark_of(line)
    used = [run for run in runs if not run.values.keys().isdisjoint(_named(line))]
    if not used:
        return _joined([*cells[:-1], f"`tools/bench {name}`, {_ABSENT}"])
    by = "; ".join(f"`tools/bench {name}{_brief(run.options)}`, {run.date}, {run.commit}" for run in used)
    older = _OLDER_IN_A_ROW if any(run.code != code_of(name, run.options) for run in used) else ""
    return _joined([*cells[:-2], _filled(line, used), by + older])


def _brief(options: str) -> str:
    return options if len(options) <= _MOST_IN_A_CELL else f" {options.split(maxsplit=1)[0]} ..."


def _filled(line: str, runs: Sequence[Run]) -> str:
    values = {name: value for run in runs for name, value in run.values.items()}
    names = _named(line)
    if template := _COMMENT.search(_cells(line)[0]):
        return template[1].format_map(dict.fromkeys(names, _ABSENT) | values)
    return ", ".join(values[name] for name in names if name in values) or _ABSENT


def _benchmark_of(line: str) -> str:
    return re.findall(r"`tools/bench (\w+)", line)[-1]


def _named(line: str) -> list[str]:
    cell = _cells(line)[0]
    template = _COMMENT.search(cell)
    return re.findall(r"\{(\w+)\}", template[1]) if template else re.findall(r"`(\w+)`", cell)


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip().strip("|").split("|")]


def _joined(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _table_of_goals(name: str, runs: Sequence[Run]) -> list[str]:
    path = baseline_file(name)
    goals = {key: entry["goal"] for key, entry in read_baseline(path)["figures"].items()} if path.is_file() else {}
    rows = [_row(f"| `{key}` | {goal:g} | |", runs) for key, goal in goals.items() if isinstance(goal, int | float)]
    return ["| figure | goal | measured |", "|---|---|---|", *rows]


def _shown(entry: Mapping[str, Any]) -> str:
    value = entry["value"]
    if isinstance(value, str):
        return value
    size = abs(value)
    number = f"{value / 1e6:.3g} million" if size >= 1e6 else f"{value:,.0f}" if size >= 1000 else f"{value:.3g}"
    unit = {"": "", "1/s": " a second"}.get(entry["unit"], f" {entry['unit']}")
    interval = entry.get("interval")
    return number + unit + (f" ({interval[0]:.2f} to {interval[1]:.2f})" if interval else "")
