"""A recording with truth written in the layout of HOPE-Video."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hickory_stream.base.json_text import dumps
from hickory_stream.evaluation.truth import Truth, mesh_of
from hickory_stream.geometry.mesh import Mesh
from hickory_stream.geometry.rigid import invert
from players import open_source
from tools.paper_tables.hope import CM_PER_M

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
