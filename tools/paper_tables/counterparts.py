"""Synthetic counterparts of the data sets, written in their layouts so that the same readers read them."""
# A world of our own generator written in the layout of ReplicaCAD. A recording with truth written in the layout of
# HOPE-Video. The scenes are drawn from seeds that nothing else in the project uses. A scene that is there stays.

import shutil
import tempfile
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from hickory_stream.base.json_text import dumps
from hickory_stream.cli.logs.odometry import tum_text
from hickory_stream.evaluation.data_sets import CM_PER_M
from hickory_stream.evaluation.truth import Truth, mesh_of, moved_mesh
from hickory_stream.geometry.mesh import Mesh, write_glb
from hickory_stream.geometry.rigid import invert, quaternion_from_rotation
from hickory_stream.worlds.object_models import model_mesh
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.scene import World
from players import open_source
from tools.paper_tables.data_sets import HOPE, KIMERA_MULTI, NUS_CLB, REPLICA_CAD
from tools.paper_tables.replica_cad import Z_UP_FROM_Y_UP, joined
from tools.paper_tables.workshop import Plan
from tools.worlds.layouts import KimeraMultiLog
from tools.worlds.outdoor.walk import outdoors
from tools.worlds.recording_config import RecordingConfig, drawn_frame, walkable_world

_Y_UP_FROM_Z_UP = invert(Z_UP_FROM_Y_UP)


def write_replica_cad(world: World, root: Path, name: str) -> None:
    """Write a world as the apartment `name` of the data set in `root`, which may hold others."""
    for folder in ("configs/scenes", "configs/objects", "objects", "stages"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    stage = f"{name}_stage"
    walls = model_mesh(joined(stage, [(model, np.eye(4)) for model in world.structure]))
    write_glb(moved_mesh(walls, _Y_UP_FROM_Z_UP), root / "stages" / f"{stage}.glb")
    instances = []
    for item in world.objects:
        template = f"{name}_{item.id:03d}_{item.model.kind}"
        mesh = moved_mesh(model_mesh(item.model), _Y_UP_FROM_Z_UP)
        write_glb(mesh, root / "objects" / f"{template}.glb")
        config = {"render_asset": f"../../objects/{template}.glb", "mass": 1.0}
        (root / "configs" / "objects" / f"{template}.object_config.json").write_text(dumps(config), encoding="utf-8")
        pose = _Y_UP_FROM_Z_UP @ item.world_from_object @ Z_UP_FROM_Y_UP
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        instances.append({
            "template_name": f"objects/{template}", "motion_type": "STATIC", "translation": pose[:3, 3].tolist(),
            "rotation": [w, x, y, z],
        })  # fmt: skip
    scene = {
        "translation_origin": "asset_local",
        "stage_instance": {"template_name": f"stages/{stage}", "translation_origin": "asset_local"},
        "object_instances": instances,
        "articulated_object_instances": [],
    }
    (root / "configs" / "scenes" / f"{name}.scene_instance.json").write_text(dumps(scene, indent=1), encoding="utf-8")


_MM_PER_M = 1000.0


def write_hope(log: Path, truth: Truth, scene: Path, meshes: Path) -> None:
    """Write a log and its truth as the folder of a scene, and the meshes of its objects into the data set's."""
    scene.mkdir(parents=True, exist_ok=True)
    meshes.mkdir(parents=True, exist_ok=True)
    names = {item.id: f"{scene.name}_{item.id:02d}_{item.kind}" for item in truth.objects}
    for item in truth.objects:
        _write_obj(mesh_of(truth, item), meshes / f"{names[item.id]}.obj")
    source = open_source(log)
    for number, raw in enumerate(source.frames()):
        frame = raw.decode()
        camera_from_world = invert(frame.world_from_camera)
        annotated: list[dict[str, Any]] = []
        for item in truth.objects:
            camera_from_object = camera_from_world @ item.world_from_object
            camera_from_object[:3, 3] *= CM_PER_M
            annotated.append({"class": names[item.id], "pose": camera_from_object.tolist()})
        record = {
            "camera": {
                "width": frame.camera.width,
                "height": frame.camera.height,
                "intrinsics": frame.camera.K.tolist(),
                "extrinsics": camera_from_world.tolist(),
            },
            "objects": annotated,
        }
        (scene / f"{number:04d}.json").write_text(dumps(record), encoding="utf-8")
        depth_mm = np.nan_to_num(frame.depth_m * _MM_PER_M).round().clip(0, 65535).astype(np.uint16)
        _write_image(scene / f"{number:04d}_rgb.jpg", np.ascontiguousarray(frame.rgb[..., ::-1]))
        _write_image(scene / f"{number:04d}_depth.png", depth_mm)
    source.close()


def _write_image(path: Path, image: Any) -> None:
    path.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())


def _write_obj(mesh: Mesh, path: Path) -> None:
    rows = np.concatenate([mesh.vertices.astype(np.float64) * CM_PER_M, mesh.colors / 255.0], axis=1)
    lines = ["v " + " ".join(f"{value:.5f}" for value in row) for row in rows]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in mesh.faces]
    path.write_text("\n".join(lines) + "\n", encoding="ascii")


_SEED = 41_000
# Walks of the robots of each pair; odd walks go the other way round.
_ROBOT_WALKS = ((0, 1), (0, 2), (1, 2))
_ROBOTS = 3


def write_counterparts(plan: Plan, data: Path, told: Callable[[str], None]) -> None:
    """Write what a plan needs below `data`, as if it had been downloaded."""
    for i in range(plan.hope_scenes):
        _once(data / HOPE.folders[0] / "hope_video" / f"scene_{i:04d}", told, partial(_table, plan, i))
    root = data / REPLICA_CAD.folders[0]
    for i in range(plan.apartments):
        if not (root / "configs" / "scenes" / f"apt_{i}.scene_instance.json").is_file():
            told(f"writing {root.name}/apt_{i}")
            world, _ = walkable_world(RecordingConfig(scene="apartment", seed=_SEED + 100 + i, seconds=10.0))
            write_replica_cad(world, root, f"apt_{i}")
    for i in range(plan.robot_pairs):
        _once(data / KIMERA_MULTI.folders[0] / f"scene_{i + 1}", told, partial(_robots, plan, i))
    for i in range(plan.nus_pairs):
        _once(data / NUS_CLB.folders[0] / f"scene_{i + 1}", told, partial(_quadruped, plan, i))


def _once(target: Path, told: Callable[[str], None], write: Callable[[Path], None]) -> None:
    if target.is_dir():
        return
    told(f"writing {target.parent.name}/{target.name}")
    target.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".unfinished.", dir=target.parent) as unfinished:
        made = Path(unfinished) / target.name
        write(made)
        shutil.move(made, target)


def _table(plan: Plan, i: int, target: Path) -> None:
    config = RecordingConfig(scene="tabletop", seed=_SEED + i, seconds=plan.hope_seconds, width=640, height=480)
    with tempfile.TemporaryDirectory() as folder:
        truth = make_recording(config, Path(folder), "table")
        # Meshes are shared by all scenes of the data set, two folders above.
        meshes = target.parents[2] / "meshes" / "eval"
        write_hope(Path(folder) / "table.mcap", truth, target, meshes)


def _robots(plan: Plan, i: int, target: Path) -> None:
    target.mkdir()
    base = RecordingConfig(
        scene="outdoor", seed=_SEED + 200 + i, seconds=plan.robot_seconds, rate_hz=5.0, layout="kimera_multi",
        robots=_ROBOTS, width=640, height=480,
    )  # fmt: skip
    _side_by_side(partial(_robot, base, target), _ROBOT_WALKS[i % len(_ROBOT_WALKS)])


def _robot(base: RecordingConfig, target: Path, walk: int) -> None:
    config = outdoors(replace(base, walk_index=walk))
    name = f"robot{walk + 1}"
    truth = make_recording(config, target, name)
    body_from_camera = KimeraMultiLog.body_from_infra1 @ KimeraMultiLog.infra1_from_color
    lines = ["#timestamp_kf,x,y,z,qw,qx,qy,qz"]
    for stamp_ns, pose in _common(truth, config).items():
        world_from_body = pose @ invert(body_from_camera)
        x, y, z, w = quaternion_from_rotation(world_from_body[:3, :3]).tolist()
        lines.append(",".join([str(stamp_ns), *(f"{n:.9f}" for n in (*world_from_body[:3, 3], w, x, y, z))]))
    (target / f"{name}_gt_odom.csv").write_text("\n".join(lines) + "\n", encoding="ascii")


def _quadruped(plan: Plan, i: int, target: Path) -> None:
    target.mkdir()
    base = RecordingConfig(
        scene="apartment", seed=_SEED + 300 + i, seconds=plan.nus_seconds, rate_hz=4.0, layout="nus_clb", robots=2,
        width=640, height=360, camera_offset=True,
    )  # fmt: skip
    _side_by_side(partial(_run, base, target), (0, 1))


def _run(base: RecordingConfig, target: Path, walk: int) -> None:
    config = replace(base, walk_index=walk)
    truth = make_recording(config, target, f"run{walk + 1}")
    poses = _common(truth, config)
    (target / f"run{walk + 1}.tum").write_text(tum_text(list(poses), list(poses.values())), encoding="ascii")


def _side_by_side(record: Callable[[int], None], walks: tuple[int, ...]) -> None:
    with ProcessPoolExecutor(len(walks), mp_context=get_context("spawn")) as pool:
        list(pool.map(record, walks))


def _common(truth: Truth, config: RecordingConfig) -> dict[int, NDArray[np.float64]]:
    robot_from_common = drawn_frame(config)
    common_from_robot = np.eye(4) if robot_from_common is None else invert(robot_from_common)
    return {frame.stamp_ns: common_from_robot @ frame.world_from_camera for frame in truth.frames}
