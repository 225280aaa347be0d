"""The committed baseline of a benchmark: for each figure its last value, its goal, and by how much it may fall back."""
# `baselines/NAME.json` has `value`, `goal` and `tolerance` for each figure; null: none. A figure regresses when it is
# worse than its value by more than the tolerance; a text with tolerance 0 must stay equal.

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hickory_stream.base.json_text import dumps
from tools.benchmarks.common.figures import Figure
from tools.benchmarks.common.processes import ROOT

FOLDER = ROOT / "tools" / "benchmarks" / "baselines"
QUICK = "quick_"
"""The prefix of figures of a quick run that are of another sample than those of a whole run."""


@dataclass(kw_only=True, slots=True)
class Comparison:
    """Figures against a baseline, each list in words; `missing` are in the baseline, and were not measured."""

    regressions: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    goals_met: list[str] = field(default_factory=list)
    goals_open: list[str] = field(default_factory=list)


def baseline_file(name: str) -> Path:
    return ROOT / "tests" / "golden" / "baseline.json" if name == "golden" else FOLDER / f"{name}.json"


def read_baseline(path: Path) -> dict[str, Any]:
    """Return a baseline: `about`, a text, and `figures` by name."""
    # Raises ValueError: the file is no baseline.
    content = json.loads(path.read_text(encoding="utf-8"))
    for name, entry in content["figures"].items():
        tolerance = entry["tolerance"]
        if entry["better"] not in ("higher", "lower", "same") or (tolerance is not None and tolerance < 0):
            raise ValueError(f"{path}: {name} is {entry}")
    return dict(content)


def check(path: Path, figures: Sequence[Figure], *, is_partial: bool) -> int:
    """Print how figures compare with a baseline; return 1 where one fell back, or is missing from a whole run."""
    found = compare(figures, read_baseline(path))
    for title, lines in (
        ("goals that are met", found.goals_met),
        ("goals that are not", found.goals_open),
        ("not measured", found.missing),
        ("fell back", found.regressions),
    ):
        if lines:
            print(f"{title}:", *(f"  {line}" for line in lines), sep="\n")
    is_bad = bool(found.regressions) or (bool(found.missing) and not is_partial)
    print(f"check against {path.name}: {'a regression' if is_bad else 'no regression'}")
    return int(is_bad)


def compare(figures: Sequence[Figure], baseline: dict[str, Any]) -> Comparison:
    measured = {figure.name: figure.value for figure in figures}
    found = Comparison()
    for name, entry in baseline["figures"].items():
        before, goal = entry["value"], entry["goal"]
        if name not in measured:
            if before is not None and not name.startswith(QUICK):
                found.missing.append(name)
            continue
        value, tolerance = measured[name], entry["tolerance"]
        if before is not None and _is_worse(value, before, tolerance, entry["better"]):
            found.regressions.append(f"{name} is {_text(value)}, was {_text(before)} (tolerance {tolerance})")
        if goal is not None:
            goals = found.goals_open if _is_worse(value, goal, 0.0, entry["better"]) else found.goals_met
            goals.append(f"{name} is {_text(value)}, goal {_text(goal)}")
    return found


def set_baseline(path: Path, figures: Sequence[Figure], about: str) -> None:
    """Write measured values into a baseline; goals, tolerances and other figures stay as they are."""
    entries = read_baseline(path)["figures"] if path.is_file() else {}
    for figure in figures:
        before = entries.get(figure.name, {"goal": None, "tolerance": None})
        value = round(figure.value, 4) if isinstance(figure.value, float) else figure.value
        limits = {"goal": before["goal"], "tolerance": before["tolerance"]}
        entries[figure.name] = {"value": value, **limits, "better": figure.better, "unit": figure.unit}
    path.write_text(dumps({"about": about, "figures": entries}, indent=1) + "\n", encoding="utf-8")


def _is_worse(value: float | str, before: float | str, tolerance: float | None, better: str) -> bool:
    if isinstance(value, str) or isinstance(before, str):
        return tolerance == 0 and value != before
    if tolerance is None:
        return False
    return value < before - tolerance if better == "higher" else value > before + tolerance


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
