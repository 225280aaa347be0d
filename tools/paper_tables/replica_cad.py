"""Apartments of ReplicaCAD in their published layout: scene instances, object configs, stages and articulated things.

The files are those of Habitat: y up, metres, quaternions w x y z; templates are named with or without their folder.
Where objects are placed by their centre of mass (`translation_origin` "COM"), that is the config's `COM`, or the middle
of the mesh's bounding box, as in Habitat. Articulated things stand as they do at joint position zero. Facts from the
documentation of habitat-sim's JSON attributes and from the loaders of Habitat and ManiSkill.
"""

import json
import math
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hickory_stream.errors import RecordingError
from hickory_stream.geometry.rigid import apply, from_rotation_translation, rotation_from_quaternion
from hickory_stream.worlds.object_models import Model, Part
from hickory_stream.worlds.scene import World, WorldObject
from hickory_stream.worlds.textures import Texture

Z_UP_FROM_Y_UP = from_rotation_translation(np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]), np.zeros(3))
_UP_COSINE, _FLOOR_STEP_M, _FLOOR_SHARE = 0.95, 0.02, 0.3
# A swinging or sliding leaf in an opening of the wall belongs to the building, as it does in our own truth.
_BUILDING_PARTS = ("door",)
# A part of a model has one plain colour: faces are grouped by their colour in steps of so many grey levels.
_STEP = 32


def scene_names(root: Path) -> list[str]:
    """Return the apartments of a data set's folder, `apt_0` and so on."""
    return sorted(
        file.name.removesuffix(".scene_instance.json")
        for file in (root / "configs" / "scenes").glob("apt_*.scene_instance.json")
    )


def read_apartment(root: Path, name: str) -> World:
    """Return an apartment, z up, with its floor at z = 0."""
    # Raises RecordingError: a file is missing or damaged; the text names it and says what was expected.
    path = root / "configs" / "scenes" / f"{name}.scene_instance.json"
    scene = _json(path)
    try:
        stage = _stage(root, scene["stage_instance"])
        placed = [
            _object(root, item, str(scene.get("translation_origin", "COM"))) for item in scene["object_instances"]
        ]
        placed += [_articulated(root, item) for item in scene.get("articulated_object_instances", [])]
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise RecordingError(
            f"{path}: {error!r}; expected stage_instance, object_instances with template_name, translation and rotation"
        ) from error
    floor_m = floor_height_m(stage)
    down = from_rotation_translation(np.eye(3), np.array([0.0, 0.0, -floor_m]))
    is_building = [any(word in model.kind for word in _BUILDING_PARTS) for model, _ in placed]
    things = [item for item, fixed in zip(placed, is_building, strict=True) if not fixed]
    fixed = [item for item, fixed in zip(placed, is_building, strict=True) if fixed]
    structure = [joined(model.kind, [(model, down @ pose)]) for model, pose in [(stage, np.eye(4)), *fixed]]
    low, high = structure[0].bounds_m()
    return World(
        objects=tuple(
            WorldObject(id=i, model=model, world_from_object=down @ pose)
            for i, (model, pose) in enumerate(things, start=1)
        ),
        structure=tuple(structure),
        rooms_m=((float(low[0]), float(low[1]), float(high[0]), float(high[1])),),
        middle_m=(float((low[0] + high[0]) / 2), float((low[1] + high[1]) / 2)),
    )


def floor_height_m(stage: Model) -> float:
    """Return the lowest height with much level area that looks up: as that of floors, but not yet that of roofs."""
    heights, areas = [], []
    for part in stage.parts:
        a, b, c = (part.vertices[part.faces[:, i]] for i in range(3))
        normals = np.cross(b - a, c - a)
        area = np.linalg.norm(normals, axis=1) / 2
        is_up = normals[:, 2] > 2 * _UP_COSINE * np.maximum(area, 1e-12)
        heights.append(((a + b + c) / 3)[is_up, 2])
        areas.append(area[is_up])
    height, area = np.concatenate(heights), np.concatenate(areas)
    if not len(height):
        return float(stage.bounds_m()[0, 2])
    steps = np.floor(height / _FLOOR_STEP_M).astype(np.int64)
    lowest = steps.min()
    by_step = np.bincount(steps - lowest, weights=area)
    inside = steps - lowest == int(np.argmax(by_step >= _FLOOR_SHARE * by_step.max()))
    return float(np.average(height[inside], weights=area[inside]))


def _stage(root: Path, instance: dict[str, Any]) -> Model:
    name = _base(instance["template_name"])
    config = root / "configs" / "stages" / f"{name}.stage_config.json"
    path = root / "stages" / f"{name}.glb"
    if config.is_file():
        asset = _json(config).get("render_asset")
        path = config.parent / str(asset) if asset else path
    return model_of_file(path.resolve(), "stage", Z_UP_FROM_Y_UP)


def _object(root: Path, instance: dict[str, Any], origin: str) -> tuple[Model, NDArray[np.float64]]:
    name = _base(instance["template_name"])
    config_path = root / "configs" / "objects" / f"{name}.object_config.json"
    config = _json(config_path)
    asset = (config_path.parent / str(config["render_asset"])).resolve()
    scale = np.ones(3) * np.asarray(config.get("scale", 1.0), dtype=np.float64)
    scale = scale * np.asarray(instance.get("non_uniform_scale", 1.0)) * float(instance.get("uniform_scale", 1.0))
    scaled = np.diag([*scale, 1.0])
    model = model_of_file(asset, name, Z_UP_FROM_Y_UP @ scaled)
    if str(instance.get("translation_origin", origin)).upper() != "ASSET_LOCAL":
        middle = model.bounds_m().mean(axis=0)
        if "COM" in config:
            middle = apply(Z_UP_FROM_Y_UP, (scale * np.asarray(config["COM"], dtype=np.float64))[None])[0]
        model = joined(name, [(model, from_rotation_translation(np.eye(3), -middle))])
    return _with_own_frame(model, _placed(instance))


def _articulated(root: Path, instance: dict[str, Any]) -> tuple[Model, NDArray[np.float64]]:
    name = _base(instance["template_name"])
    path = root / "urdf" / name / f"{name}.urdf"
    scale = float(instance.get("uniform_scale", 1.0))
    turned = Z_UP_FROM_Y_UP @ np.diag([scale, scale, scale, 1.0])
    parts = []
    for mesh, robot_from_mesh in _visuals(path):
        parts.append((model_of_file(mesh, name, turned @ robot_from_mesh), np.eye(4)))
    if not parts:
        raise RecordingError(f"{path} shows nothing: expected links with a visual mesh")
    return _with_own_frame(joined(name, parts), _placed(instance))


def _visuals(path: Path) -> list[tuple[Path, NDArray[np.float64]]]:
    try:
        robot = ET.parse(path).getroot()
    except (OSError, ET.ParseError) as error:
        raise RecordingError(f"{path} cannot be read as a URDF: {error}") from error
    parent_of = {}
    for joint in robot.findall("joint"):
        parent, child = joint.find("parent"), joint.find("child")
        if parent is not None and child is not None:
            parent_of[child.get("link")] = (parent.get("link"), _origin(joint.find("origin")))
    found = []
    for link in robot.findall("link"):
        robot_from_link, name, seen = np.eye(4), link.get("name"), set()
        while name in parent_of and name not in seen:
            seen.add(name)
            name, parent_from_child = parent_of[name]
            robot_from_link = parent_from_child @ robot_from_link
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and mesh.get("filename"):
                scale = [float(word) for word in (mesh.get("scale") or "1 1 1").split()]
                link_from_mesh = _origin(visual.find("origin")) @ np.diag([*scale, 1.0])
                found.append((path.parent / str(mesh.get("filename")), robot_from_link @ link_from_mesh))
    return found


def _origin(origin: ET.Element | None) -> NDArray[np.float64]:
    if origin is None:
        return np.eye(4)
    xyz = [float(word) for word in (origin.get("xyz") or "0 0 0").split()]
    rpy = [float(word) for word in (origin.get("rpy") or "0 0 0").split()]
    return from_rotation_translation(Rotation.from_euler("xyz", rpy).as_matrix(), np.array(xyz))


def _placed(instance: dict[str, Any]) -> NDArray[np.float64]:
    w, x, y, z = (float(value) for value in instance.get("rotation", (1.0, 0.0, 0.0, 0.0)))
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if not length > 0:
        raise ValueError(f"the rotation {[w, x, y, z]} is no quaternion")
    rotation = rotation_from_quaternion(x / length, y / length, z / length, w / length)
    translation = np.asarray(instance.get("translation", (0.0, 0.0, 0.0)), dtype=np.float64)
    pose = from_rotation_translation(rotation, translation)
    return np.asarray(Z_UP_FROM_Y_UP @ pose @ Z_UP_FROM_Y_UP.T)


def _with_own_frame(model: Model, world_from_object: NDArray[np.float64]) -> tuple[Model, NDArray[np.float64]]:
    low, high = model.bounds_m()
    base = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
    parts = tuple(Part(vertices=p.vertices - base, faces=p.faces, texture=p.texture) for p in model.parts)
    return Model(kind=model.kind, parts=parts), world_from_object @ from_rotation_translation(np.eye(3), base)


def _base(template: str) -> str:
    return template.rsplit("/", 1)[-1]


def _json(path: Path) -> dict[str, Any]:
    try:
        record = json.loads(path.read_bytes())
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error}") from error
    except ValueError as error:
        raise RecordingError(f"{path} is damaged: {error}; expected JSON") from error
    if not isinstance(record, dict):
        raise RecordingError(f"{path} holds {type(record).__name__}; expected an object")
    return record


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
