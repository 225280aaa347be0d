"""Meshes of others as models of our worlds: GLB and OBJ files with textures, materials or vertex colours."""
# A model's part has one plain colour: faces are grouped by their colour in steps of 32 grey levels.

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.rigid import apply
from hickory_stream.worlds.object_models import Model, Part
from hickory_stream.worlds.textures import Texture

_STEP = 32


def model_of_file(path: Path, kind: str, model_from_file: NDArray[np.float64]) -> Model:
    """Return the model in a GLB or OBJ file; `model_from_file` (4, 4) may scale."""
    # Raises RecordingError: the file is missing, or holds no triangles.
    import trimesh

    if not path.is_file():
        raise RecordingError(f"{path} is missing: the mesh of {kind}")
    try:
        scene = trimesh.load_scene(path)
        meshes = [mesh for mesh in scene.dump() if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces)]
    except (ValueError, KeyError, IndexError, TypeError, OSError) as error:
        raise RecordingError(f"{path} cannot be read as a mesh: {error!r}") from error
    if not meshes:
        raise RecordingError(f"{path} holds no triangles: expected the mesh of {kind}")
    return Model(kind=kind, parts=tuple(part for mesh in meshes for part in _parts(mesh, model_from_file)))


def joined(kind: str, models: list[tuple[Model, NDArray[np.float64]]]) -> Model:
    """Return models, each with its pose (4, 4) in the frame of the whole, as one."""
    parts = [
        Part(vertices=apply(whole_from_model, part.vertices), faces=part.faces, texture=part.texture)
        for model, whole_from_model in models
        for part in model.parts
    ]
    return Model(kind=kind, parts=tuple(parts))


def _parts(mesh: Any, model_from_file: NDArray[np.float64]) -> list[Part]:
    vertices = apply(model_from_file, np.asarray(mesh.vertices, dtype=np.float64))
    faces = np.asarray(mesh.faces, dtype=np.int32)
    if np.linalg.det(model_from_file[:3, :3]) < 0:
        faces = faces[:, ::-1]
    colors = _face_colors(mesh)
    keys, groups = np.unique(colors // _STEP, axis=0, return_inverse=True)
    groups = groups.ravel()
    parts = []
    for i in range(len(keys)):
        chosen = faces[groups == i]
        used, local = np.unique(chosen, return_inverse=True)
        red, green, blue = (float(x) / 255 for x in colors[groups == i].mean(axis=0))
        texture = Texture(pattern="plain", first=(red, green, blue), second=(red, green, blue))
        parts.append(Part(vertices=vertices[used], faces=local.reshape(-1, 3).astype(np.int32), texture=texture))
    return parts


def _face_colors(mesh: Any) -> NDArray[np.int64]:
    visual = mesh.visual
    if visual.kind == "texture":
        visual = visual.to_color()
    colors = np.asarray(visual.vertex_colors, dtype=np.int64)[:, :3]
    if len(colors) != len(mesh.vertices):
        return np.full((len(mesh.faces), 3), 180, dtype=np.int64)
    return np.asarray(colors[mesh.faces].mean(axis=1).round().astype(np.int64))
