"""Layers 3 and 4 of shapes by others: every closed mesh of their rooms and scans, each shape once."""
# A mesh is closed if, with equal vertices joined, each edge has two faces. Structure, such as a wall, is no object.
# Every other mesh of the rooms and scans for tuning is reported, and all of the rooms for reporting.

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh

from hickory_stream.errors import RecordingError
from tools.benchmarks.common.figures import Figure, Options, figure, mean
from tools.benchmarks.foreign.logs import worlds_folder
from tools.benchmarks.shapes.rows import disturbed, fit, of_diameter_one, rotation, row_of
from tools.evaluation.shape_score import shape_score

_TUNED = ("home", "bookstore")
_HELD_OUT = ("service-office", "warehouse")
# Meshes with as many faces, and as much surface and volume to this share, are one shape.
_ALIKE = 0.02
_QUICK = 8


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class ForeignShape:
    """A closed mesh, its name, and whether it is reported: nothing was tuned on it."""

    name: str
    mesh: trimesh.Trimesh
    is_reported: bool


def foreign_figures(options: Options) -> list[Figure]:
    """Return the figures of both halves, and print a line per object; none where there are no such meshes."""
    try:
        worlds = worlds_folder(options.worlds)
    except RecordingError as error:
        print(f"no shapes by others: {error}")
        return []
    shapes = closed_shapes(worlds)
    rng = np.random.default_rng(options.seed + 3000)
    figures = []
    for half, is_reported in (("foreign", True), ("foreign_tuned", False)):
        own = [shape for shape in shapes if shape.is_reported == is_reported]
        figures += _of_half(half, own[1::_QUICK] if options.quick else own, rng, options)
    return figures


def closed_shapes(worlds: Path) -> list[ForeignShape]:
    """Return the closed meshes of a folder of worlds, and of the scans beside it, by name; each shape once."""
    seen: set[tuple[int, int, int]] = set()
    shapes, num_tuned = [], 0
    for name, file in _files(worlds):
        mesh = _joined(file)
        if not (mesh.is_watertight and mesh.volume > 0):
            continue
        key = (len(mesh.faces), round(np.log(mesh.area) / _ALIKE), round(np.log(mesh.volume) / _ALIKE))
        if key not in seen:
            seen.add(key)
            is_held_out = name.startswith(_HELD_OUT)
            shapes.append(ForeignShape(name=name, mesh=mesh, is_reported=is_held_out or num_tuned % 2 == 1))
            num_tuned += not is_held_out
    return shapes


def _files(worlds: Path) -> Iterator[tuple[str, Path]]:
    for world in (*_TUNED, *_HELD_OUT):
        objects = json.loads((worlds / world / "world.json").read_text())["objects"]
        for name in sorted({item["mesh"] for item in objects if not item["is_structure"]}):
            yield f"{world}-{Path(name).stem}", worlds / world / name
    for file in sorted((worlds.parent / "data" / "ycb").glob("*.obj")):
        yield f"ycb-{file.stem}", file


def _joined(file: Path) -> trimesh.Trimesh:
    found = trimesh.load(file, force="mesh", process=False)
    mesh = trimesh.Trimesh(found.vertices, found.faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def _of_half(half: str, shapes: list[ForeignShape], rng: np.random.Generator, options: Options) -> list[Figure]:
    rows = [row_of(shape.name, shape.mesh, rotation(rng), options, is_thin=True) for shape in shapes]
    scores: dict[str, list[float]] = {"self_rotation": [], "self_noise": [], "self_scale": []}
    for shape in shapes:
        mesh = of_diameter_one(shape.mesh)
        reference = fit(mesh).primitives
        for kind, other in disturbed(mesh, rng):
            scores[kind].append(shape_score(reference, fit(other).primitives))
    ratios, solid = [row.volume_ratio for row in rows], [row.iou for row in rows if row.kind != "envelope"]
    proven = [row.grown.certificate.holds and not row.grown.is_fallback for row in rows]
    of, role = f"{len(rows)} closed meshes by others", "reported" if half == "foreign" else "tuned"
    return [
        mean(f"{half}_iou_mean", [row.iou for row in rows], "", "higher", of, role=role),
        mean(f"{half}_iou_without_envelopes", solid, "", "higher", f"{len(solid)} of {of}", role=role),
        figure(f"{half}_iou_min_without_envelopes", min(solid), "", "higher", of, role=role),
        figure(f"{half}_envelopes", len(rows) - len(solid), "", "lower", of, role=role),
        mean(f"{half}_inflated_ratio", ratios, "x", "lower", of, role=role),
        figure(f"{half}_inflated_ratio_max", max(ratios), "x", "lower", of, role=role),
        figure(f"{half}_certified_fraction", np.mean(proven), "", "higher", of, role=role),
        mean(f"{half}_fit_seconds", [row.fit_seconds for row in rows], "s", "lower", of, role=role),
        mean(f"{half}_inflate_seconds", [row.inflate_seconds for row in rows], "s", "lower", of, role=role),
        *(mean(f"{half}_{kind}", values, "", "higher", of, role=role) for kind, values in scores.items()),
    ]
