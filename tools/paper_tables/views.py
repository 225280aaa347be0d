"""The paper's table of views: every strategy, each object reconstructed from its one best view, against true meshes."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.config import MapperConfig
from hickory_stream.errors import HickoryError
from hickory_stream.evaluation.data_sets import open_truth
from players import open_source
from tools.benchmarks.common.intervals import bootstrap, wilson
from tools.evaluation.view_trials import STRATEGIES, try_views
from tools.paper_tables.data_sets import HOPE, REPLICA_CAD
from tools.paper_tables.logs import logs_of
from tools.paper_tables.published import VIEWS
from tools.paper_tables.tables import Cell, Column, Table
from tools.paper_tables.workshop import Log, Plan, Workshop, identity_of, refusal

_TITLES = {
    "initial": "Initial view", "max_area": "Largest mask", "max_box": "Largest 2D box",
    "max_volume": "Largest 3D volume", "s_score": "View score S (ours)",
}  # fmt: skip
# ADD-S counts as right below this share of an object's diameter, as in the paper.
_ADDS_SHARE = {HOPE.name: 0.05, REPLICA_CAD.name: 0.1}


def views_table(data: Path, plan: Plan, shop: Workshop, caption: str) -> Table:
    """Return the table; a data set without logs has empty cells that say why."""
    sets = {name: _found(name, data, plan, shop) for name in _ADDS_SHARE}
    rows = []
    for strategy in sorted(STRATEGIES, key=list(_TITLES).index):
        cells: list[Cell] = []
        for name, found in sets.items():
            cells += _cells(name, found if isinstance(found, str) else found[strategy], VIEWS[strategy][name])
        rows.append((_TITLES[strategy], tuple(cells)))
    columns = []
    for data_set in (HOPE, REPLICA_CAD):
        share = _ADDS_SHARE[data_set.name]
        columns += [
            Column(name=f"{data_set.name}_f1", title=f"{data_set.title}: mean F1", digits=4, more=1),
            Column(name=f"{data_set.name}_adds", title=f"{data_set.title}: ADD-S < {share} d", digits=4, more=1),
        ]
    return Table(
        name="views",
        caption=f"View selection and reconstruction ({caption})",
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            "Ours: F1 at 5 % of the true diameter and ADD-S over all true objects that count, 0 for one that the map "
            "misses; meshes by the embedded single-view reconstructor where the paper has SAM 3D.",
        ),
    )


def _found(name: str, data: Path, plan: Plan, shop: Workshop) -> dict[str, list[Any]] | str:
    try:
        logs = logs_of(name, data, plan, shop)
        rows = [row for log, truth in logs for row in _objects(log, truth, shop)]
    except HickoryError as error:
        return refusal(error)
    return {strategy: [row[strategy] for row in rows] for strategy in STRATEGIES} if logs else "no logs"


def _objects(log: Log, folder: Path, shop: Workshop) -> list[Any]:
    def measure() -> list[Any]:
        truth = open_truth(folder)
        (file,) = log.files  # a folder of HOPE-Video, or a log of our renderer
        source = open_source(file)
        with tempfile.TemporaryDirectory(prefix="hickory-views-") as temporary:
            try:
                trials = try_views(source, truth, MapperConfig(), Path(temporary) / "map")
            finally:
                source.close()
        return [
            {
                strategy: [0.0, None] if (score := trial.scores.get(strategy)) is None
                else [score.f1_5pct, score.add_s_m / trial.diameter_m]
                for strategy in STRATEGIES
            }
            for trial in trials
        ]  # fmt: skip

    found: list[Any] = shop.once(f"views-{log.label}", {"log": identity_of(log)}, measure)
    return found


def _cells(name: str, found: list[Any] | str, paper: tuple[float, float]) -> list[Cell]:
    if isinstance(found, str) or not found:
        why = found if isinstance(found, str) else "no true object counts"
        return [Cell(value=None, paper=figure, why=why) for figure in paper]
    f1 = np.array([row[0] for row in found])
    right = sum(row[1] is not None and row[1] < _ADDS_SHARE[name] for row in found)
    low, high = bootstrap([f1], lambda groups: float(groups[0].mean()))
    adds_low, adds_high = wilson(right, len(found))
    return [
        Cell(value=float(f1.mean()), low=low, high=high, num=len(found), paper=paper[0]),
        Cell(value=right / len(found), low=adds_low, high=adds_high, num=len(found), paper=paper[1]),
    ]
