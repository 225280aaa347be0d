"""The objects of `tools/bench layer2`: models of the own worlds, and single things of rooms by others."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hickory_stream.geometry.mesh import Mesh, mesh_of_glb
from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import Model, model_triangles
from tools.evaluation.shapes.spoiled_generator import plain_mesh
from tools.worlds import big_things, table_things

_OWN = {
    small_things: "monitor box mug bottle bowl book_stack",
    big_things: "armchair stool office_chair side_table coffee_table bed suitcase basket speaker dresser",
    furniture: "table desk chair sofa shelf lamp plant bin_",
    table_things: "television laptop kettle pot pan vase can jar cereal_box squeeze_bottle toy_car cushion table_lamp"
    " clock",
}
TUNED_WORLDS = ("home", "bookstore")
_FACES = (30, 60_000)
_SIZE_M = (0.08, 4.0)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Subject:
    """An object that stands on z = 0, and another one of its class; None where there is none."""

    kind: str
    mesh: Mesh
    other: Mesh | None


def own_subjects(count: int, seed: int) -> list[Subject]:
    """Return so many objects of the own worlds, kind after kind."""
    makers = [getattr(module, name) for module, names in _OWN.items() for name in names.split()]

    def made(make: Callable[[np.random.Generator], Model], rng: np.random.Generator) -> Mesh:
        vertices, faces = model_triangles(make(rng))
        return plain_mesh(vertices.astype(np.float64), faces)

    subjects = []
    for i in range(count):
        make, rng = makers[i % len(makers)], np.random.default_rng([seed, i])
        subjects.append(Subject(kind=make.__name__.rstrip("_"), mesh=made(make, rng), other=made(make, rng)))
    return subjects


def foreign_subjects(worlds: Path, names: tuple[str, ...], most: int | None = None) -> list[Subject]:
    """Return the things of these worlds, each mesh once, by kind; the other one of its class is another mesh of it."""
    # At most `most`, spread over the kinds.
    meshes: dict[str, dict[str, Mesh]] = {}
    for name in names:
        folder = worlds / name
        for item in json.loads((folder / "world.json").read_text())["objects"]:
            file = folder / item["mesh"]
            found = meshes.setdefault(item["kind"], {})
            if not item["is_structure"] and str(file) not in found and (mesh := _read(file)) is not None:
                found[str(file)] = mesh
    subjects = []
    for kind, found in sorted(meshes.items()):
        sorted_meshes = [found[file] for file in sorted(found)]
        others = [*sorted_meshes[1:], *sorted_meshes[:1]] if len(found) > 1 else [None]
        subjects += [
            Subject(kind=kind, mesh=mesh, other=other)
            for mesh, other in zip(sorted_meshes, others, strict=len(found) > 0)
        ]
    return subjects if most is None else subjects[:: -(-len(subjects) // most)]


def _read(file: Path) -> Mesh | None:
    try:
        mesh = mesh_of_glb(file.read_bytes())
    except ValueError:
        return None
    size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    if not (_FACES[0] <= len(mesh.faces) <= _FACES[1] and _SIZE_M[0] <= size <= _SIZE_M[1]):
        return None
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    foot = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    return plain_mesh(mesh.vertices.astype(np.float64) - foot, mesh.faces)
