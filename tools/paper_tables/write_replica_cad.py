"""A world of our own generator written in the layout of ReplicaCAD."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from hickory_stream.base.json_text import dumps
from hickory_stream.evaluation.truth import moved_mesh
from hickory_stream.geometry.mesh import Mesh, write_glb
from hickory_stream.geometry.rigid import invert
from hickory_stream.worlds.object_models import model_mesh
from hickory_stream.worlds.scene import World
from tools.paper_tables.replica_cad import Z_UP_FROM_Y_UP

_Y_UP_FROM_Z_UP = invert(Z_UP_FROM_Y_UP)


def write_replica_cad(world: World, root: Path, name: str) -> None:
    """Write a world as the apartment `name` of the data set in `root`, which may hold others."""
    for folder in ("configs/scenes", "configs/objects", "objects", "stages"):
        (root / folder).mkdir(parents=True, exist_ok=True)
    stage = f"{name}_stage"
    walls = _merged([model_mesh(model) for model in world.structure])
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
        instances.append(
            {
                "template_name": f"objects/{template}",
                "motion_type": "STATIC",
                "translation": pose[:3, 3].tolist(),
                "rotation": [w, x, y, z],
            }
        )
    scene = {
        "translation_origin": "asset_local",
        "stage_instance": {"template_name": f"stages/{stage}", "translation_origin": "asset_local"},
        "object_instances": instances,
        "articulated_object_instances": [],
    }
    (root / "configs" / "scenes" / f"{name}.scene_instance.json").write_text(dumps(scene, indent=1), encoding="utf-8")


def _merged(meshes: Sequence[Mesh]) -> Mesh:
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])[:-1]
    return Mesh(
        vertices=np.concatenate([mesh.vertices for mesh in meshes]),
        faces=np.concatenate([mesh.faces + at for mesh, at in zip(meshes, offsets, strict=True)]).astype(np.int32),
        colors=np.concatenate([mesh.colors for mesh in meshes]),
        is_seen=np.concatenate([mesh.is_seen for mesh in meshes]),
    )
