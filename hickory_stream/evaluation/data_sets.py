"""Truth from annotations of public data sets: poses of models (BOP, HOPE), labels of a mesh (ScanNet), boxes (ARKit).

How much of an object was seen is measured on samples of its surface, as for the figures of `evaluate`.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.evaluate import seen_samples, true_surface
from hickory_stream.evaluation.labels import LABELS_FILE, load_labels
from hickory_stream.evaluation.match import TrueBox
from hickory_stream.evaluation.truth import (
    TRUTH_FILE,
    Truth,
    TruthFrame,
    TruthObject,
    load_truth,
    moved_mesh,
    structure_meshes,
)
from hickory_stream.geometry.boxes import OrientedBox
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.pictures.raycast import Scene, surface_of_mesh
from players.logs.layouts.bop import OBJECTS, read_objects
from players.logs.layouts.folder import FolderFrame, FolderSource, decoded
from players.logs.layouts.folder_text import expecting, read_text, read_world_from_log
from players.logs.layouts.frame_collector import by_number
from players.logs.layouts.table import layout_of
from players.options import SourceOptions
from players.poses.interpolation import nearest_rigid

_MODELS = ("models_eval", "models", "models_cad", "models_reconst")
CM_PER_M = 100.0
"""HOPE's meshes and the poses of its objects are in centimetres, its cameras in metres."""
# Annotations of one object of HOPE may disagree by so much.
_STILL_M = 0.03
_SAME_OBJECT_M = 0.1
# What is nearer by so much than an object hides it: depth is noisy.
_HIDDEN_M, _HIDDEN_SHARE = 0.05, 0.03
_STRUCTURE = ("wall", "floor", "ceiling")


def open_truth(folder: Path) -> Truth:
    """Return the truth in a truth folder, or by the annotations of a data set's folder. Raises `RecordingError`."""
    if (folder / TRUTH_FILE).exists() or not folder.is_dir() or (layout := layout_of(folder)) is None:
        return load_truth(folder)
    source = layout.open(folder, SourceOptions(odometry="topic"))
    read = {"BOP scene": _bop, "HOPE folder": _hope, "ScanNet folder": _scannet}.get(source.info.kind)
    if read is None or not isinstance(source, FolderSource):
        expected = "a truth folder, or annotations of BOP, HOPE or ScanNet"
        raise RecordingError(f"found {folder} of the kind {source.info.kind!r} without truth, expected {expected}")
    truth = read(Path(source.info.uri), source)
    surfaces = {item.id: true_surface(truth, item) for item in truth.objects}
    seen = seen_samples(truth, surfaces, structure_meshes(truth))
    objects = tuple(replace(item, seen_fraction=float(seen[item.id].mean())) for item in truth.objects)
    return replace(truth, objects=objects)


def open_boxes(path: Path) -> tuple[TrueBox, ...] | None:
    """Return the boxes that were labelled by hand: of a file of them, or ARKitScenes' annotation beside its frames.

    None if the path has none, or has a whole truth. Raises `RecordingError`.
    """
    if path.is_file() or ((path / LABELS_FILE).is_file() and not (path / TRUTH_FILE).is_file()):
        return load_labels(path)
    file = next(iter(sorted(path.glob("*_3dod_annotation.json"))), None)
    if file is None:
        return None
    upright_from_world = read_world_from_log(path)
    with expecting(file, "data with label, and in segments.obbAligned centroid, axesLengths and normalizedAxes"):
        boxes = list[TrueBox]()
        for entry in json.loads(read_text(file))["data"]:
            aligned = {
                name: np.asarray(value, dtype=np.float64) for name, value in entry["segments"]["obbAligned"].items()
            }
            axes = aligned["normalizedAxes"].reshape(3, 3).T
            # A box is the same along the opposite of an axis.
            rigid = nearest_rigid(from_rotation_translation(axes * np.sign(np.linalg.det(axes)), aligned["centroid"]))
            if rigid is None:
                raise ValueError("normalizedAxes that are no rotation")
            box = OrientedBox(world_from_box=upright_from_world @ rigid, half_extents_m=aligned["axesLengths"] / 2)
            boxes.append(TrueBox(id=len(boxes) + 1, kind=str(entry["label"]), counts=True, boxes=(box,)))
        if not boxes:
            raise ValueError("no boxes")
    return tuple(boxes)


@dataclass(slots=True)
class _Instance:
    # An object: its pose in the world by every image, and by image its place in the list of objects.
    kind: str
    poses: list[NDArray[np.float64]] = field(default_factory=list)
    places: dict[int, int] = field(default_factory=dict)


def _bop(scene: Path, source: FolderSource) -> Truth:
    if not (scene / OBJECTS).is_file():
        raise RecordingError(f"{scene} has no {OBJECTS}: the poses of its objects are not public")
    objects, found = read_objects(scene), list[_Instance]()
    numbers = [next(iter(by_number([Path(str(files.color))]))) for files in source.content.frames]
    for index, (files, number) in enumerate(zip(source.content.frames, numbers, strict=True)):
        for place, (model, camera_from_object) in enumerate(objects.get(number, ())):
            if camera_from_object is None:
                continue
            kind, pose = f"obj_{model:06d}", files.pose @ camera_from_object
            # Instances of one model are told apart by where they are.
            near = [one for one in found if one.kind == kind and index not in one.places]
            apart_m = [float(np.linalg.norm(one.poses[0][:3, 3] - pose[:3, 3])) for one in near]
            if not apart_m or min(apart_m) > _SAME_OBJECT_M:
                found.append(_Instance(kind))
                near, apart_m = [found[-1]], [0.0]
            one = near[int(np.argmin(apart_m))]
            one.poses.append(pose)
            one.places[index] = place

    def paint(frame: TruthFrame) -> NDArray[np.uint16]:
        import cv2

        camera = source.content.frames[frame.index].view.registration.color_camera
        shown = np.zeros((camera.height, camera.width), dtype=np.uint16)
        for i, one in enumerate(found):
            if frame.index in one.places:
                file = scene / f"mask_visib/{numbers[frame.index]:06d}_{one.places[frame.index]:06d}.png"
                mask = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) if file.is_file() else None
                if mask is None or mask.shape != shown.shape:
                    raise RecordingError(f"{file} is no mask of {camera.width}x{camera.height} pixels")
                shown[mask > 0] = i + 1
        return shown

    truth = _posed(scene, source, found, _bop_model)
    return replace(truth, paint=paint if (scene / "mask_visib").is_dir() else truth.paint)


def _hope(scene: Path, source: FolderSource) -> Truth:
    # An object is one of a class, the n-th of its JSON.
    found = dict[tuple[str, int], _Instance]()
    jsons = by_number(scene.glob("*.json"))
    for index, files in enumerate(source.content.frames):
        file = jsons[next(iter(by_number([Path(str(files.color))])))]
        kinds = list[str]()
        with expecting(file, "objects with class and pose (4x4)"):
            for place, entry in enumerate(json.loads(read_text(file))["objects"]):
                kinds.append(str(entry["class"]))
                camera_from_object = np.array(entry["pose"], dtype=np.float64).reshape(4, 4)
                camera_from_object[:3, 3] /= CM_PER_M
                key = (kinds[-1], kinds.count(kinds[-1]))
                one = found.setdefault(key, _Instance(kinds[-1]))
                one.poses.append(files.pose @ camera_from_object)
                one.places[index] = place
    for (kind, nth), one in found.items():
        places = np.array([pose[:3, 3] for pose in one.poses])
        apart_m = float(np.median(np.linalg.norm(places - np.median(places, axis=0), axis=1)))
        if apart_m > _STILL_M:
            raise RecordingError(
                f"{scene}: {kind} {nth} moves by {apart_m:.2f} m between frames; expected objects that stay in place, "
                "extrinsics in metres and object poses in centimetres"
            )
    return _posed(scene, source, [found[key] for key in sorted(found)], _hope_model)


def _posed(scene: Path, source: FolderSource, found: Sequence[_Instance], model: Callable[[Path, str], Mesh]) -> Truth:
    items = tuple(
        TruthObject(
            id=i,
            kind=one.kind,
            mesh=one.kind,
            world_from_object=_middle(one.poses),
            seen_fraction=1.0,
            frames=tuple(sorted(one.places)),
        )
        for i, one in enumerate(found, start=1)
    )
    return _truth(scene, source, items, {kind: model(scene, kind) for kind in sorted({one.kind for one in found})})


def _middle(poses: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    # The pose whose place is nearest to the median of all.
    places = np.array([pose[:3, 3] for pose in poses])
    return poses[int(np.linalg.norm(places - np.median(places, axis=0), axis=1).argmin())]


def _bop_model(scene: Path, kind: str) -> Mesh:
    files = [scene.parent.parent / folder / f"{kind}.ply" for folder in _MODELS]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        raise RecordingError(f"{scene.parent.parent} has no {files[0].name} in {', '.join(_MODELS)}")
    return _read_mesh(file, 1000.0)


def _hope_model(scene: Path, kind: str) -> Mesh:
    return _read_mesh(scene.parent.parent / "meshes" / "eval" / f"{kind}.obj", CM_PER_M)


def _scannet(scene: Path, source: FolderSource) -> Truth:
    mesh_file, segments_file, groups_file = (
        _annotation(scene, ending)
        for ending in ("_vh_clean_2.ply", "_vh_clean_2.0.010000.segs.json", "[0-9].aggregation.json")
    )
    whole = moved_mesh(_read_mesh(mesh_file, 1.0), source.content.world_from_log)
    with expecting(segments_file, f"segIndices of the {len(whole.vertices)} vertices of {mesh_file.name}"):
        segments = np.array(json.loads(read_text(segments_file))["segIndices"], dtype=np.int64)
        if segments.shape != (len(whole.vertices),):
            raise ValueError(f"{segments.shape} indices")
    meshes, items = dict[str, Mesh](), list[TruthObject]()
    every = tuple(range(len(source.content.frames)))
    with expecting(groups_file, "segGroups with segments and label"):
        groups = [
            (str(group["label"]), np.array(group["segments"], dtype=np.int64))
            for group in json.loads(read_text(groups_file))["segGroups"]
        ]
    for i, (label, of_group) in enumerate(groups, start=1):
        part = _part(whole, np.isin(segments, of_group))
        name = f"{i} {label}"
        if len(part.faces):
            meshes[name] = part
        if len(part.faces) and label not in _STRUCTURE:
            items.append(
                TruthObject(id=i, kind=label, mesh=name, world_from_object=np.eye(4), seen_fraction=1.0, frames=every)
            )
    objects = {item.mesh for item in items}
    return _truth(scene, source, tuple(items), meshes, tuple(name for name in meshes if name not in objects))


def _truth(
    folder: Path,
    source: FolderSource,
    objects: tuple[TruthObject, ...],
    meshes: Mapping[str, Mesh],
    structure: tuple[str, ...] = (),
) -> Truth:
    if not objects:
        raise RecordingError(f"{folder} has no annotated object")
    frames = source.content.frames
    scene: Scene | None = None

    def paint(frame: TruthFrame) -> NDArray[np.uint16]:
        nonlocal scene
        if scene is None:
            solids = [(item.id, moved_mesh(meshes[item.mesh], item.world_from_object)) for item in objects]
            solids += [(0, meshes[name]) for name in structure]
            scene = Scene([surface_of_mesh(mesh, i) for i, mesh in solids])
        return _cast(scene, frames[frame.index], source)

    return Truth(
        folder=folder,
        camera=source.info.camera,
        objects=objects,
        structure=structure,
        frames=tuple(
            TruthFrame(
                index=i,
                stamp_ns=files.stamp_ns,
                world_from_camera=files.pose,
                instances="",
                camera=files.view.registration.color_camera,
            )
            for i, files in enumerate(frames)
        ),
        meshes=meshes,
        paint=paint,
    )


def _cast(scene: Scene, files: FolderFrame, source: FolderSource) -> NDArray[np.uint16]:
    # The object of each pixel, 0 for none, or where something that is not annotated stands before it.
    frame = decoded(files, source.content.sensor)
    rays = backproject(np.ones(frame.depth_m.shape, dtype=np.float32), frame.camera).reshape(-1, 3)
    lengths = np.linalg.norm(rays, axis=1)
    directions = (rays / lengths[:, None]) @ files.pose[:3, :3].T
    hits = scene.cast(np.broadcast_to(files.pose[:3, 3], directions.shape), directions)
    depth_m = (hits.distance_m / lengths).reshape(frame.depth_m.shape)
    with np.errstate(invalid="ignore"):
        is_hidden = frame.depth_m < depth_m - _HIDDEN_M - _HIDDEN_SHARE * depth_m
    return np.where(is_hidden, 0, hits.owners.reshape(depth_m.shape).clip(0)).astype(np.uint16)


def _annotation(scene: Path, ending: str) -> Path:
    found = next((file for folder in (scene, scene.parent) for file in sorted(folder.glob(f"*{ending}"))), None)
    if found is None:
        raise RecordingError(f"{scene} has no *{ending}, which ScanNet has for a scene with labels")
    return found


def _part(mesh: Mesh, chosen: NDArray[np.bool_]) -> Mesh:
    new = np.cumsum(chosen) - 1
    faces = mesh.faces[chosen[mesh.faces].all(axis=1)]
    return Mesh(
        vertices=mesh.vertices[chosen], faces=new[faces], colors=mesh.colors[chosen], is_seen=mesh.is_seen[chosen]
    )


def _read_mesh(file: Path, units_per_m: float) -> Mesh:
    import trimesh

    try:
        # From a stream, so that no texture is looked for.
        with file.open("rb") as stream:
            found: Any = trimesh.load(stream, file_type=file.suffix[1:], force="mesh", process=False)
        vertices, faces = np.asarray(found.vertices) / units_per_m, np.asarray(found.faces)
        if not (len(faces) and np.isfinite(vertices).all() and 0 <= faces.min() and faces.max() < len(vertices)):
            raise ValueError("no triangles")
        # A model with a texture stays grey.
        colors = np.asarray(getattr(found.visual, "vertex_colors", np.empty((0, 3))))[:, :3]
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, ArithmeticError, EOFError) as error:
        raise RecordingError(f"{file} cannot be read as a mesh: {error!r:.200}") from error
    if colors.shape != vertices.shape:
        colors = np.full(vertices.shape, 180)
    return Mesh(
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        colors=colors.astype(np.uint8),
        is_seen=np.ones(len(vertices), dtype=bool),
    )
