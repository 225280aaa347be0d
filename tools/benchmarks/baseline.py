"""The committed baseline of a benchmark: what each figure was, what it is to become, and how far it may fall back.

`baselines/NAME.json` (`tests/golden/baseline.json` for the golden logs) has for each figure `value` (null: not measured
yet), `goal` (null: none) and `tolerance`: a figure that is worse than its value by more than that is a regression. A
tolerance is about the noise of the figure; a text whose tolerance is 0, such as a digest, must stay as it is.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hickory_stream.base.json_text import dumps
from tools.benchmarks.processes import ROOT

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tools.benchmarks.figures import Figure

FOLDER = Path(__file__).parent / "baselines"
QUICK = "quick_"
"""What a figure of a quick run is called: a whole run has none of them."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Comparison:
    """Figures against a baseline, each list in words: what fell back, what was not measured, and which goals are met.

    `missing` are figures that the baseline has and the measurement has not.
    """

    regressions: tuple[str, ...]
    missing: tuple[str, ...]
    goals_met: tuple[str, ...]
    goals_open: tuple[str, ...]


def baseline_file(name: str) -> Path:
    """Return where the baseline of a benchmark is, whether there is one or not."""
    if name == "golden":
        return ROOT / "tests" / "golden" / "baseline.json"
    return FOLDER / f"{name}.json"


def read_baseline(path: Path) -> dict[str, Any]:
    """Return a baseline: `about`, a text, and `figures` by name.

    Raises:
        ValueError: the file is no baseline.
    """
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


def set_baseline(path: Path, figures: Sequence[Figure], about: str) -> None:
    """Write measured values into a baseline; goals, tolerances and what was not measured stay as they are."""
    before = read_baseline(path) if path.is_file() else {}
    path.write_text(dumps(updated(before, figures, about), indent=1) + "\n", encoding="utf-8")


def compare(figures: Sequence[Figure], baseline: dict[str, Any]) -> Comparison:
    """Return how figures compare with a baseline."""
    measured = {figure.name: figure.value for figure in figures}
    regressions, missing, met, open_ = [], [], [], []
    for name, entry in baseline["figures"].items():
        if name not in measured:
            if entry["value"] is not None and not name.startswith(QUICK):
                missing.append(name)
            continue
        value, before, goal = measured[name], entry["value"], entry["goal"]
        if before is not None and _is_worse(value, before, entry["tolerance"], entry["better"]):
            regressions.append(f"{name} is {_text(value)}, was {_text(before)} (tolerance {entry['tolerance']})")
        if goal is not None:
            told = f"{name} is {_text(value)}, goal {_text(goal)}"
            (open_ if _is_worse(value, goal, 0.0, entry["better"]) else met).append(told)
    return Comparison(
        regressions=tuple(regressions), missing=tuple(missing), goals_met=tuple(met), goals_open=tuple(open_)
    )


def updated(baseline: dict[str, Any], figures: Sequence[Figure], about: str) -> dict[str, Any]:
    """Return a baseline with measured values; goals and tolerances stay, and so do figures that were not measured."""
    entries = {name: dict(entry) for name, entry in baseline.get("figures", {}).items()}
    for figure in figures:
        kept = entries.get(figure.name, {"goal": None, "tolerance": None})
        entries[figure.name] = {
            "value": round(figure.value, 4) if isinstance(figure.value, float) else figure.value,
            "goal": kept["goal"],
            "tolerance": kept["tolerance"],
            "better": figure.better,
            "unit": figure.unit,
        }
    return {"about": about, "figures": entries}


def _is_worse(value: float | str, before: float | str, tolerance: float | None, better: str) -> bool:
    """Return whether a value is worse than another; one without a tolerance is told, but judged by nobody."""
    if isinstance(value, str) or isinstance(before, str):
        return tolerance == 0 and value != before
    if tolerance is None:
        return False
    return value < before - tolerance if better == "higher" else value > before + tolerance


def _text(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"
