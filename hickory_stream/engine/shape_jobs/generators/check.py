"""Test of a generator on a built-in object: requirements, result and duration."""

import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.box_scene import SCENE_BOXES, shape_inputs
from hickory_stream.engine.shape_jobs.generators.choose import ExternalGenerator
from hickory_stream.engine.shape_jobs.generators.spec import GeneratorSpec, fingerprint, missing_of
from hickory_stream.errors import WorkerError
from hickory_stream.geometry.camera import project
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.ports import MeshPlacement, NoShape
from hickory_stream.shapes.generated.placement import EmbeddedPlacement, PlacementConfig

_FRAMES = (0, 6, 12)
_DRAWN = np.array([230, 60, 40], np.uint8)


def checked(spec: GeneratorSpec, path: Path) -> tuple[dict[str, Any], NDArray[np.uint8] | None]:
    """Return facts about a generator, and a picture of its mesh of a box, over the box's image."""
    missing = missing_of(spec)
    facts: dict[str, Any] = {
        "name": spec.name,
        "file": str(path),
        "command": " ".join(spec.command),
        "licence": spec.licence,
        "acceptance": spec.acceptance,
        "weights": len(spec.weights),
        "missing": missing,
        "is_usable": False,
    }
    if missing:
        return {**facts, "state": f"lacks {'; '.join(missing)}"}, None
    facts["fingerprint"] = fingerprint(spec)
    generator = ExternalGenerator(spec)
    started = time.perf_counter()
    try:
        said = generator.process.start()
        facts |= {"start_s": round(time.perf_counter() - started, 2), "said": {k: str(v) for k, v in said.items()}}
        return _tried(generator, facts)
    except WorkerError as error:
        return {**facts, "state": str(error)}, None
    finally:
        generator.process.close()


def _tried(generator: ExternalGenerator, facts: dict[str, Any]) -> tuple[dict[str, Any], NDArray[np.uint8] | None]:
    inputs = shape_inputs(SCENE_BOXES[-1:], _FRAMES)
    started = time.perf_counter()
    found = generator.generate(inputs)
    seconds, memory_mb = time.perf_counter() - started, generator.process.most_memory_mb
    facts |= {"job_s": round(seconds, 2), "memory_mb": round(memory_mb, 1)}
    if isinstance(found, NoShape):
        return {**facts, "state": found.reason}, None
    facts |= {"vertices": len(found.mesh.vertices), "triangles": len(found.mesh.faces)}
    placed = EmbeddedPlacement(PlacementConfig()).place(found.mesh, inputs)
    if not isinstance(placed, MeshPlacement):
        return {**facts, "state": placed.reason}, None
    crop = inputs.crops[0]
    world = apply(placed.world_from_mesh, found.mesh.vertices.astype(np.float64))
    pixels = np.round(project(apply(invert(crop.world_from_camera), world), crop.camera))
    picture = crop.rgb.copy()
    is_inside = ((pixels >= 0) & (pixels < (crop.camera.width, crop.camera.height))).all(axis=1)
    columns, rows = pixels[is_inside].astype(np.int64).T
    picture[rows, columns] = _DRAWN
    return {**facts, "state": "ok", "cost": round(placed.cost, 3), "is_usable": True}, picture
