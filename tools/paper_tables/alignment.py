"""The paper's table of alignment: two maps of a place by our method and its competitors, against truth."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.methods import Method, align_by
from hickory_stream.cli.maps.align import objects_of
from hickory_stream.errors import HickoryError
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.map_folder.saved_map import open_map
from tools.evaluation.alignment_error import error_of
from tools.evaluation.alignment_truth import true_a_from_b
from tools.paper_tables.logs import Pair, apartment_pairs, kimera_pairs, nus_pairs
from tools.paper_tables.published import ALIGNMENT
from tools.paper_tables.tables import Cell, Column, Table, mean_of
from tools.paper_tables.workshop import Plan, Workshop, refusal

_METHODS: dict[Method, str] = {
    "bbox": "Mesh-BBox", "roman-xl": "ROMAN-XL", "roman-one": "ROMAN-One", "sq": "Superquadrics (ours)",
}  # fmt: skip
_FIGURES = ("num_pairs", "translation_m", "rotation_deg", "overlap_m")
_UNKNOWN = (None, None, None)


def alignment_table(data: Path, plan: Plan, shop: Workshop, caption: str) -> Table:
    """Return the table: a row for each scene and method, and the mean of each data set's scenes that were answered."""
    pairs, notes = _pairs(data, plan, shop)
    answers: dict[tuple[str, str], dict[Method, Any]] = {}
    for pair in pairs:
        try:
            answers[pair.data_set, pair.scene] = _answers(pair, shop)
        except HickoryError as error:
            notes.append(f"{pair.data_set} {pair.scene}: {refusal(error)}")
    rows = []
    places: dict[str, int] = {}
    for (data_set, scene), found in answers.items():
        nth = places.setdefault(data_set, 0)
        places[data_set] += 1
        for method, title in _METHODS.items():
            published = ALIGNMENT[method].get(data_set, ())
            paper = published[nth] if nth < len(published) else _UNKNOWN
            rows.append((f"{data_set} {scene}: {title}", _cells(found[method], paper)))
    for data_set in places:
        rows += [(f"{data_set} mean: {title}", _means(method, data_set, answers)) for method, title in _METHODS.items()]
    return Table(
        name="alignment",
        caption=f"Map alignment ({caption})",
        columns=(
            Column(name="num_pairs", title="Associated objects", digits=0),
            Column(name="translation_m", title="Translation", unit="m", digits=4, more=-1),
            Column(name="rotation_deg", title="Rotation", unit="deg", digits=4, more=-1),
            Column(name="overlap_m", title="Error where the maps overlap", unit="m", digits=4, more=-1),
        ),
        rows=tuple(rows),
        groups=(len(_METHODS),) * (len(answers) + len(places)),
        notes=(
            "Errors of the transform itself, as in the paper, its translation at the origin of map b; a method that "
            "refuses has none. The order of the paper's scenes is not known to be that of ours.",
            *notes,
        ),
    )


def _pairs(data: Path, plan: Plan, shop: Workshop) -> tuple[list[Pair], list[str]]:
    found: list[Pair] = []
    notes = []
    try:
        found += apartment_pairs(data, plan, shop)
    except HickoryError as error:
        notes.append(f"ReplicaCAD: {refusal(error)}")
    return found + kimera_pairs(data, plan) + nus_pairs(data, plan), notes


def _answers(pair: Pair, shop: Workshop) -> dict[Method, Any]:
    folders = [shop.map_of(log) for log in pair.logs]

    def measure() -> dict[str, Any]:
        saved_a, saved_b = (open_map(folder) for folder in folders)
        true, a, b = true_a_from_b(saved_a, saved_b, pair.truths), objects_of(saved_a), objects_of(saved_b)
        return {method: row_of(align_by(method, a, b), true) for method in _METHODS}

    name = f"alignment-{pair.data_set}-{pair.scene}"
    found: dict[Method, Any] = shop.once(name, {"maps": [folder.name for folder in folders]}, measure)
    return found


def row_of(answer: Alignment | NoAlignment, true_a_from_b: NDArray[np.float64]) -> dict[str, Any]:
    """Return the pairs and the errors of an answer, None where it refuses, and the reason of a refusal."""
    if not isinstance(answer, Alignment):
        return {**dict.fromkeys(_FIGURES), "num_pairs": 0, "refusal": answer.refusal.value}
    error = error_of(answer.a_from_b, true_a_from_b, apply(invert(true_a_from_b), answer.center_a))
    values = (len(answer.pairs), error.origin_m, error.rotation_deg, error.translation_m)
    return {**dict(zip(_FIGURES, values, strict=True)), "refusal": None}


def _cells(found: dict[str, Any], paper: tuple[float | None, ...]) -> tuple[Cell, ...]:
    why = "" if found["refusal"] is None else f"refused: {found['refusal']}"
    return tuple(
        Cell(value=None if why else found[name], paper=None if published is None else float(published), why=why)
        for name, published in zip(_FIGURES, (*paper, None), strict=True)
    )


def _means(method: Method, data_set: str, answers: dict[tuple[str, str], dict[Method, Any]]) -> tuple[Cell, ...]:
    rows = [found[method] for (name, _), found in answers.items() if name == data_set]
    answered = [row for row in rows if row["refusal"] is None and row["overlap_m"] is not None]
    published = ALIGNMENT[method].get(data_set)
    papers = (*map(mean_of, zip(*published, strict=True)), None) if published else (*_UNKNOWN, None)
    why = "" if answered else "all refused"
    return tuple(
        Cell(value=mean_of([row[name] for row in answered]), num=len(answered), paper=paper, why=why)
        for name, paper in zip(_FIGURES, papers, strict=True)
    )
