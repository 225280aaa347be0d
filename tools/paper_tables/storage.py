"""The paper's table of storage and time: what each layer takes on disk, and how long it takes to build."""

import json
from pathlib import Path
from typing import Any

from hickory_stream.errors import HickoryError
from hickory_stream.map_folder.saved_map import open_map
from tools.paper_tables.data_sets import DATA_SETS
from tools.paper_tables.logs import logs_of
from tools.paper_tables.published import NUM_OBJECTS, STORAGE
from tools.paper_tables.tables import Cell, Column, Table, mean_of
from tools.paper_tables.workshop import Log, Plan, Workshop, refusal

_LAYERS = {1: "Layer 1: point cloud", 2: "Layer 2: mesh", 3: "Layer 3: superquadrics", 4: "Layer 4: inflated"}
# Scale (3), exponents (2), rotation (3) and translation (3) in float32, as the paper counts a superquadric.
_SUPERQUADRIC_BYTES = 11 * 4
_POINT_BYTES = 3 * 4 + 3


def storage_table(data: Path, plan: Plan, shop: Workshop, caption: str) -> Table:
    """Return the table: mean KiB and processor seconds of a map's layers, for each data set."""
    sets = {data_set.name: _measured(data_set.name, data, plan, shop) for data_set in DATA_SETS}
    rows = []
    for layer, title in _LAYERS.items():
        cells: list[Cell] = []
        for name, found in sets.items():
            kib, seconds = STORAGE[layer][name]
            cells += [_cell(found, f"layer{layer}_kib", kib), _cell(found, f"layer{layer}_s", seconds)]
        rows.append((title, tuple(cells)))
    counts = []
    for name, found in sets.items():
        counts += [_cell(found, "objects", NUM_OBJECTS[name]), Cell(value=None)]
    rows.append(("Objects with all layers", tuple(counts)))
    columns = []
    for data_set in DATA_SETS:
        columns += [
            Column(name=f"{data_set.name}_kib", title=data_set.title, unit="KiB", digits=1, more=0),
            Column(name=f"{data_set.name}_s", title=data_set.title, unit="s", digits=1, more=0),
        ]
    return Table(
        name="shapes",
        caption=f"Storage and time of the layers ({caption})",
        columns=tuple(columns),
        rows=tuple(rows),
        notes=(
            "Ours: means over maps; processor seconds of two cores without a GPU, layer 1 with perception; 15 bytes a "
            "point, 44 bytes a superquadric, meshes as stored. The paper's: an RTX 4090, of longer logs.",
        ),
    )


def _measured(name: str, data: Path, plan: Plan, shop: Workshop) -> list[dict[str, float]] | str:
    try:
        found = [_map_figures(log, shop) for log, _ in logs_of(name, data, plan, shop)]
    except HickoryError as error:
        return refusal(error)
    return found or "no logs"


def _map_figures(log: Log, shop: Workshop) -> dict[str, float]:
    folder = shop.map_of(log)

    def measure() -> dict[str, float]:
        saved = open_map(folder)
        shaped = [item for item in saved.snapshot.objects if item.shape is not None]
        timings: dict[str, Any] = json.loads((folder / "timings.json").read_bytes())
        figures = {f"layer{layer}_s": float(timings[f"layer{layer}_s"]) for layer in _LAYERS}
        points = sum(len(item.points_world) for item in shaped)
        meshes = sum(saved.mesh_path(item.shape).stat().st_size for item in shaped if item.shape is not None)
        fitted = sum(len(item.shape.fitted) for item in shaped if item.shape is not None)
        inflated = sum(len(item.shape.inflated) for item in shaped if item.shape is not None)
        sizes = (_POINT_BYTES * points, meshes, _SUPERQUADRIC_BYTES * fitted, _SUPERQUADRIC_BYTES * inflated)
        figures |= {f"layer{layer}_kib": size / 1024 for layer, size in zip(_LAYERS, sizes, strict=True)}
        return {**figures, "objects": float(len(shaped))}

    found: dict[str, float] = shop.once(f"storage-{log.label}", {"map": folder.name}, measure)
    return found


def _cell(found: list[dict[str, float]] | str, figure: str, paper: float) -> Cell:
    if isinstance(found, str):
        return Cell(value=None, paper=paper, why=found)
    return Cell(value=mean_of([one[figure] for one in found]), num=len(found), paper=paper)
