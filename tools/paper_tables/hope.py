"""HOPE-Video in its published layout, as a log with truth."""
# Depth in millimetres, extrinsics camera from world in metres, poses and meshes (`meshes/eval/CLASS.obj`) of objects in
# centimetres, as the README of the data set and its viewer have them.

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.errors import RecordingError
from hickory_stream.evaluation.truth import TRUTH_FILE, Truth, TruthFrame, TruthObject, truth_record
from hickory_stream.geometry.camera import Camera
from hickory_stream.geometry.mesh import write_glb
from hickory_stream.geometry.rigid import invert
from hickory_stream.records import Frame
from hickory_stream.worlds.object_models import model_mesh
from hickory_stream.worlds.rendering import Renderer
from hickory_stream.worlds.scene import World, WorldObject
from hickory_stream.worlds.visibility import SeenSurface
from hickory_stream.worlds.zed_log import encode_png
from players import open_source
from tools.paper_tables.meshes import model_of_file

CM_PER_M = 100.0
# How far annotations of one object may disagree over a scene, and what may cover a pixel of an object.
_STILL_M, _COVERED_M = 0.03, 0.03
_RANGE_M = (0.2, 4.0)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Annotated:
    kind: str
    camera_from_object: NDArray[np.float64]


def scene_folders(root: Path) -> list[Path]:
    return sorted(folder for folder in (root / "hope_video").glob("scene_*") if folder.is_dir())


def write_truth(scene: Path, meshes: Path, target: Path) -> Truth:
    # An object is one of a class, the n-th of its json; its place is the median over all frames.
    # Raises RecordingError: a json or a mesh is missing or damaged, or an object does not stay in place, which means
    # other units than expected.
    numbers = sorted(int(file.name[:4]) for file in scene.glob("[0-9][0-9][0-9][0-9].json"))
    objects = _objects(scene, numbers, meshes)
    world = World(objects=objects, structure=(), rooms_m=((-2.0, -2.0, 2.0, 2.0),), middle_m=(0.0, 0.0))
    for part in ("meshes", "instances"):
        (target / part).mkdir(parents=True)
    for item in objects:
        write_glb(model_mesh(item.model), target / f"meshes/{item.id}.glb")
    source = open_source(scene)
    try:
        camera, shown, seen, true_frames = _filmed(world, (raw.decode() for raw in source.frames()), target)
    finally:
        source.close()
    truth = Truth(
        folder=target,
        camera=camera,
        objects=tuple(
            TruthObject(
                id=item.id,
                kind=item.model.kind,
                mesh=f"meshes/{item.id}.glb",
                world_from_object=item.world_from_object,
                seen_fraction=round(seen.fraction(item.id), 4),
                frames=tuple(shown[item.id]),
            )
            for item in objects
        ),
        structure=(),
        frames=tuple(true_frames),
    )
    (target / TRUTH_FILE).write_text(dumps_exactly(truth_record(truth), indent=1) + "\n", encoding="utf-8")
    return truth


def _filmed(
    world: World, frames: Iterable[Frame], target: Path
) -> tuple[Camera, dict[int, list[int]], SeenSurface, list[TruthFrame]]:
    """Return the camera, in which frames each object shows, what is seen of it, and the frames; write their instances.

    A pixel shows an object where the measured depth is not nearer than its surface by more than 3 cm.
    """
    renderer = Renderer(world)
    seen = SeenSurface(world, *_RANGE_M, np.random.default_rng(0))
    shown: dict[int, list[int]] = {item.id: [] for item in world.objects}
    found: list[TruthFrame] = []
    camera: Camera | None = None
    for i, frame in enumerate(frames):
        camera = camera or frame.camera
        probe = renderer.probe(frame.camera, frame.world_from_camera)
        depth_m = probe.depth_m.reshape(frame.depth_m.shape)
        covered = frame.depth_m < depth_m - _COVERED_M
        instances = np.where(covered, 0, probe.instances.reshape(depth_m.shape)).astype(np.uint16)
        depth_m = np.where(instances > 0, depth_m, np.nan).astype(np.float32)
        seen.add(depth_m, instances, frame.camera, frame.world_from_camera)
        for item_id in np.unique(instances[instances > 0]):
            shown[int(item_id)].append(i)
        path = f"instances/{i:06d}.png"
        (target / path).write_bytes(encode_png(instances))
        found.append(
            TruthFrame(index=i, stamp_ns=frame.stamp_ns, world_from_camera=frame.world_from_camera, instances=path)
        )
    if camera is None:
        raise RecordingError(f"{target}: the scene has no frame")
    return camera, shown, seen, found


def _objects(scene: Path, numbers: list[int], meshes: Path) -> tuple[WorldObject, ...]:
    poses: dict[tuple[str, int], list[NDArray[np.float64]]] = {}
    for number in numbers:
        world_from_camera, annotated = _read(scene / f"{number:04d}.json")
        counts: dict[str, int] = {}
        for item in annotated:
            key = (item.kind, counts.setdefault(item.kind, 0))
            counts[item.kind] += 1
            poses.setdefault(key, []).append(world_from_camera @ item.camera_from_object)
    if not poses:
        raise RecordingError(f"{scene}: none of {len(numbers)} json files names an object; expected `objects`")
    found = []
    for object_id, ((kind, nth), seen) in enumerate(sorted(poses.items()), start=1):
        places = np.array([pose[:3, 3] for pose in seen])
        middle = np.median(places, axis=0)
        away_m = np.linalg.norm(places - middle, axis=1)
        if np.median(away_m) > _STILL_M:
            raise RecordingError(
                f"{scene}: {kind} {nth} moves by {np.median(away_m):.2f} m between frames; expected objects that stay "
                "in place, extrinsics in metres and object poses in centimetres"
            )
        model = model_of_file(meshes / f"{kind}.obj", kind, np.diag([1 / CM_PER_M] * 3 + [1.0]))
        found.append(WorldObject(id=object_id, model=model, world_from_object=seen[int(np.argmin(away_m))]))
    return tuple(found)


def _read(path: Path) -> tuple[NDArray[np.float64], list[_Annotated]]:
    try:
        record: Any = json.loads(path.read_bytes())
        camera_from_world = np.array(record["camera"]["extrinsics"], dtype=np.float64).reshape(4, 4)
        annotated = []
        for item in record["objects"]:
            pose = np.array(item["pose"], dtype=np.float64).reshape(4, 4)
            pose[:3, 3] /= CM_PER_M
            annotated.append(_Annotated(kind=str(item["class"]), camera_from_object=pose))
    except OSError as error:
        raise RecordingError(f"{path} cannot be read: {error}") from error
    except (KeyError, TypeError, ValueError) as error:
        raise RecordingError(
            f"{path}: {error!r}; expected camera.extrinsics and objects with class and pose"
        ) from error
    return invert(camera_from_world), annotated
