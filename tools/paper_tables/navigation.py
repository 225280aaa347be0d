"""The paper's table of navigation: boxes, meshes and layer 4 of our maps as obstacles, planned on, against truth."""

from pathlib import Path
from typing import Any

from hickory_stream.errors import HickoryError
from hickory_stream.evaluation.truth import load_truth
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.navigation.robot import load_robot
from tools.benchmarks.common.intervals import wilson
from tools.evaluation.navigation_table import score_saved_map, table_json
from tools.paper_tables.data_sets import REPLICA_CAD
from tools.paper_tables.logs import logs_of
from tools.paper_tables.published import NAVIGATION
from tools.paper_tables.tables import Cell, Column, Table, mean_of
from tools.paper_tables.workshop import Log, Plan, Workshop, refusal

_TITLES = {"mesh-obb": "Mesh-OBB", "mesh-full": "Mesh-Full", "layer-4": "Layer 4 (ours)"}
_CELL_M = 0.033


def navigation_table(data: Path, plan: Plan, shop: Workshop, caption: str) -> Table:
    """Return the table, over the maps of all walks through the apartments."""
    scored: list[list[dict[str, Any]]] = []
    notes = []
    try:
        for log, truth in logs_of(REPLICA_CAD.name, data, plan, shop):
            scored.append(_scored(log, truth, plan, shop))
    except (HickoryError, ValueError) as error:
        notes.append(f"not measured: {str(error).splitlines()[0]}" if isinstance(error, ValueError) else refusal(error))
    rows = [(title, _cells(name, [row for rows in scored for row in rows])) for name, title in _TITLES.items()]
    return Table(
        name="navigation",
        caption=f"Navigation ({caption})",
        columns=(
            Column(name="success", title="Success", unit="%", digits=1, more=1),
            Column(name="efficiency", title="Straight line over path", digits=3, more=1),
            Column(name="build_s", title="Building the grid", unit="s", digits=3, more=-1),
            Column(name="free_space", title="Free space", digits=3, more=1),
            Column(name="missed_cells", title="Obstacle cells called free", digits=0, more=-1),
        ),
        rows=tuple(rows),
        notes=(
            f"{plan.trials} starts and goals for each of {plan.seeds} seeds in every map, connected in the true scene; "
            "what was not observed counts as blocked. The paper does not say which scene it planned in.",
            *notes,
        ),
    )


def _scored(log: Log, truth: Path, plan: Plan, shop: Workshop) -> list[dict[str, Any]]:
    folder = shop.map_of(log)

    def measure() -> list[dict[str, Any]]:
        return table_json(
            score_saved_map(
                open_map(folder), load_truth(truth), load_robot("point"), cell_m=_CELL_M, unknown="blocked",
                trials=plan.trials, seeds=range(plan.seeds),
            )
        )  # fmt: skip

    made_from = {"map": folder.name, "trials": plan.trials, "seeds": plan.seeds}
    found: list[dict[str, Any]] = shop.once(f"navigation-{log.label}", made_from, measure)
    return found


def _cells(name: str, scored: list[dict[str, Any]]) -> tuple[Cell, ...]:
    rows, paper = [row for row in scored if row["name"] == name], NAVIGATION[name]
    if not rows:
        return tuple(Cell(value=None, paper=figure, why="no maps") for figure in (*paper, None))
    tried = sum(row["pairs"] for row in rows)
    reached = round(sum(row["success"] * row["pairs"] for row in rows))
    low, high = wilson(reached, tried)
    efficiency = [row["efficiency"] for row in rows if row["efficiency"] is not None]
    return (
        Cell(value=100 * reached / tried, low=100 * low, high=100 * high, num=tried, paper=paper[0]),
        Cell(value=mean_of(efficiency), num=len(efficiency), paper=paper[1]),
        Cell(value=mean_of([row["load_s"] + row["build_s"] for row in rows]), num=len(rows), paper=paper[2]),
        Cell(value=mean_of([row["free_space"] for row in rows]), num=len(rows), paper=paper[3]),
        Cell(value=mean_of([float(row["missed_cells"]) for row in rows]), num=len(rows)),
    )
