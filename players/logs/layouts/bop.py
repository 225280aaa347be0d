"""Scenes of BOP data sets: `rgb/`, `depth/`, `scene_camera.json`, and `scene_gt.json` with the poses of objects.

Lengths in the files are millimetres. Intrinsics may differ by image. Where a scene has no camera poses (HOPE), those of
its objects, which do not move, tell how the camera moved.
"""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import CalibrationError, RecordingError
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert
from players.logs.layouts.folder import FolderSource
from players.logs.layouts.folder_text import expecting, intrinsics_of, read_text
from players.logs.layouts.frame_collector import FAR_M, FrameCollector, Pose, by_number, color_files, sizes_of
from players.options import SourceOptions
from players.poses.interpolation import nearest_rigid
from players.profile import load_profile

CAMERAS, OBJECTS = "scene_camera.json", "scene_gt.json"
# Hypotheses of objects about a camera's pose must agree so well.
_AGREE_M = 0.05

ObjectPoses = list[tuple[int, Pose]]
"""The objects in one image: the id of each one's model, and camera_from_object (4, 4), None if it is not rigid."""


def open_bop(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of one scene of a BOP data set; the name of a profile gives rate and depth noise."""
    profile = load_profile(options.profile or "bop")
    colors = color_files(folder / "rgb") or color_files(folder / "gray")
    depths = by_number((folder / "depth").glob("*.png"))
    entries = _by_image(folder / CAMERAS)
    poses: dict[int, Pose] = {}
    found = FrameCollector(folder, profile, options, rough_up=(0.0, -1.0, -1.0))
    numbers = sorted(entries.keys() & colors.keys() & depths.keys())
    views, sizes = {}, None
    for number in numbers:
        sizes = sizes or sizes_of((colors[other], depths[other]) for other in numbers)
        entry = entries[number]
        with expecting(folder / CAMERAS, f"cam_K and depth_scale of image {number}", CalibrationError):
            units_per_m = 1000.0 / float(entry.get("depth_scale", 1.0))
            views[number] = found.view(sizes, units_per_m, intrinsics_of(entry["cam_K"]))
        if "cam_R_w2c" in entry:
            with expecting(folder / CAMERAS, f"cam_R_w2c and cam_t_w2c of image {number}"):
                camera_from_world = _rigid(entry["cam_R_w2c"], entry["cam_t_w2c"])
                poses[number] = None if camera_from_world is None else invert(camera_from_world)
    origin = CAMERAS
    if not poses and (folder / OBJECTS).is_file():
        origin, poses = f"{OBJECTS}: the objects do not move", poses_by_objects(read_objects(folder))
    found.add_numbered(colors, depths, poses, views)
    return found.source(
        kind="BOP scene",
        depth_intrinsics=None,
        streams=("rgb/*", "depth/*.png", CAMERAS, origin, found.clock),
        text_files=[file for name in (CAMERAS, OBJECTS) if (file := folder / name).is_file()],
    )


def open_bop_data_set(folder: Path, options: SourceOptions) -> FolderSource:
    """Return the source of the only scene in a BOP data set. Raises `RecordingError`: it has several."""
    scenes = sorted(file.parent for file in folder.glob(f"*/*/{CAMERAS}"))
    if len(scenes) == 1:
        return open_bop(scenes[0], options)
    some = ", ".join(str(scene.relative_to(folder)) for scene in scenes[:4]) + (" ..." if len(scenes) > 4 else "")
    raise RecordingError(f"{folder} is a BOP data set of {len(scenes)} scenes; name one of them: {some}")


def read_objects(scene: Path) -> dict[int, ObjectPoses]:
    """Return the objects in each image of a scene, in their order. Raises `RecordingError`: the file cannot be read."""
    found: dict[int, ObjectPoses] = {}
    for number, entries in _by_image(scene / OBJECTS).items():
        with expecting(scene / OBJECTS, f"obj_id, cam_R_m2c and cam_t_m2c of the objects in image {number}"):
            found[number] = [(_model_of(entry), _rigid(entry["cam_R_m2c"], entry["cam_t_m2c"])) for entry in entries]
    return found


def poses_by_objects(objects: Mapping[int, ObjectPoses]) -> dict[int, Pose]:
    """Return world_from_camera of each image, by objects that do not move; the world is the first image's camera.

    None where no object is known yet, or where the objects moved against one another.
    """
    world_from_object: dict[tuple[int, int], NDArray[np.float64]] = {}
    poses: dict[int, Pose] = {}
    for number in sorted(objects):
        seen: Counter[int] = Counter()
        keyed = {}
        for model, camera_from_object in objects[number]:
            if camera_from_object is not None:
                keyed[model, seen[model]] = camera_from_object
            seen[model] += 1
        guesses = [
            compose(world_from_object[key], invert(pose)) for key, pose in keyed.items() if key in world_from_object
        ]
        pose = _most_central(guesses) if world_from_object else np.eye(4)
        poses[number] = pose if keyed else None
        if pose is not None:
            for key, camera_from_object in keyed.items():
                world_from_object.setdefault(key, compose(pose, camera_from_object))
    return poses


def _most_central(poses: list[NDArray[np.float64]]) -> Pose:
    # The pose from which the others differ least at the camera, None if half of them differ by more than that.
    if not poses:
        return None
    places = np.array([pose[:3, 3] for pose in poses])
    apart_m = np.median(np.linalg.norm(places[:, None] - places, axis=2), axis=1)
    best = int(apart_m.argmin())
    return poses[best] if apart_m[best] <= _AGREE_M else None


def _model_of(entry: Any) -> int:
    model = int(entry["obj_id"])
    if not 0 <= model < 10**6:
        raise ValueError(f"obj_id {model}")
    return model


def _by_image(file: Path) -> dict[int, Any]:
    with expecting(file, "an object with an entry for each image, by its number"):
        return {int(number): entry for number, entry in json.loads(read_text(file)).items()}


def _rigid(rotation: Any, translation_mm: Any) -> Pose:
    matrix = np.asarray(rotation, dtype=np.float64).reshape(3, 3)
    shift = np.asarray(translation_mm, dtype=np.float64).reshape(3) / 1000.0
    return nearest_rigid(from_rotation_translation(matrix, shift)) if np.abs(shift).max() < FAR_M else None
