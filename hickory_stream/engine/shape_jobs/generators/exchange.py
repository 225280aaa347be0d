"""Questions to a generator and its answers, as folders of files for any language.

rgb.png, mask.png   the best view: colour; 255 on the object
depth.npy           (H, W) float32 metres along the optical axis, 0 = none
camera.json         width, height, fx, fy, cx, cy, and world_from_camera, (4, 4) by rows; x right, y down, z forward
job.json            job, a name that the answer repeats; seed; views, their number
views/N/            the same four files of further views, from 1
mesh.glb            answer: one mesh of triangles in one buffer, no transforms; optional vertex colours
result.json         answer: job; camera_from_mesh, (4, 4) by rows, a similarity, if known
no_shape.json       instead of both: job and reason

A pose refiner gets a mesh, and its answer has no mesh.glb:

model.npz           vertices (V, 3) float32 in metres, faces (F, 3) int32; colors (V, 3) uint8, red first
result.json         job; camera_from_mesh, (4, 4) by rows, rigid
"""

import hashlib
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.confined import OutsideError, path_within, read_within
from hickory_stream.base.json_text import dumps_exactly
from hickory_stream.errors import WorkerError
from hickory_stream.geometry import portable
from hickory_stream.geometry.mesh import Mesh, mesh_of_glb
from hickory_stream.ports import Crop, GeneratedMesh, NoShape, ShapeInputs

MESH, RESULT, NO_SHAPE, JOB = "mesh.glb", "result.json", "no_shape.json", "job.json"
MODEL = "model.npz"
_MOST_BYTES = 256 << 20
_MOST_FACES = 2_000_000
_MOST_REASON = 300
_RIGID = 3e-3


def write_question(folder: Path, inputs: ShapeInputs, num_views: int, model: Mesh | None = None) -> str:
    """Write the views, and the model whose pose is asked; return the job's name, a hash of all."""
    crops = inputs.crops[:num_views]
    digest = hashlib.sha256()
    if model is not None:
        vertices, faces = model.vertices.astype("<f4"), model.faces.astype("<i4")
        np.savez(folder / MODEL, vertices=vertices, faces=faces, colors=model.colors)
        digest.update(vertices.tobytes() + faces.tobytes() + model.colors.tobytes())
    for i, crop in enumerate(crops):
        place = folder if i == 0 else folder / "views" / str(i)
        place.mkdir(parents=True, exist_ok=True)
        for name, content in _files_of(crop).items():
            (place / name).write_bytes(content)
            digest.update(name.encode() + content)
    job = digest.hexdigest()
    said = {"job": job, "seed": int(job[:8], 16), "views": len(crops)}
    (folder / JOB).write_text(dumps_exactly(said))
    return job


def _files_of(crop: Crop) -> dict[str, bytes]:
    import io

    import cv2

    depth = io.BytesIO()
    np.save(depth, np.where(np.isfinite(crop.depth_m), crop.depth_m, np.float32(0)), allow_pickle=False)
    camera = crop.camera
    said = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    said["world_from_camera"] = crop.world_from_camera.tolist()
    return {
        "rgb.png": cv2.imencode(".png", crop.rgb[:, :, ::-1])[1].tobytes(),
        "mask.png": cv2.imencode(".png", crop.mask.astype(np.uint8) * 255)[1].tobytes(),
        "depth.npy": depth.getvalue(),
        "camera.json": dumps_exactly(said).encode(),
    }


def read_answer(folder: Path, job: str, num_views: int) -> GeneratedMesh | NoShape:
    """Return the answer of a generator.

    Raises `WorkerError`: it is missing, damaged, no valid mesh, or of another job.
    """
    with _readable():
        said = _said(folder, job)
        if isinstance(said, NoShape):
            return said
        mesh = mesh_of_glb(_limited(folder, MESH))
        if len(mesh.faces) > _MOST_FACES:
            raise ValueError(f"the mesh has {len(mesh.faces)} triangles; at most {_MOST_FACES}")
        return GeneratedMesh(mesh=mesh, camera_from_mesh=_similarity(said.get("camera_from_mesh")), num_views=num_views)


def read_pose(folder: Path, job: str) -> NDArray[np.float64] | NoShape:
    """Return camera_from_mesh (4, 4) of a refiner, or why it has none.

    Raises `WorkerError`: it is missing, damaged, not rigid, or of another job.
    """
    with _readable():
        said = _said(folder, job)
        if isinstance(said, NoShape):
            return said
        found = _similarity(said.get("camera_from_mesh"))
        if found is None or abs(portable.det3(found[:3, :3]) - 1) > _RIGID:
            raise ValueError("camera_from_mesh is no rotation and place of a mesh of true size")
        return found


@contextmanager
def _readable() -> Iterator[None]:
    try:
        yield
    except (OSError, ValueError, KeyError, TypeError, OutsideError, RecursionError, MemoryError) as error:
        raise WorkerError(f"its answer is not usable: {error}") from error


def _said(folder: Path, job: str) -> dict[str, Any] | NoShape:
    name = NO_SHAPE if (folder / NO_SHAPE).exists() else RESULT
    said = json.loads(_limited(folder, name))
    if not isinstance(said, dict):
        raise ValueError(f"{name} is no object")
    if said.get("job") != job:
        raise ValueError(f"{name} answers another job")
    return said if name == RESULT else NoShape(reason=str(said.get("reason", "no reason given"))[:_MOST_REASON])


def _limited(folder: Path, name: str) -> bytes:
    size = path_within(folder, name).stat().st_size
    if size > _MOST_BYTES:
        raise ValueError(f"{name} has {size} bytes; at most {_MOST_BYTES}")
    return read_within(folder, name)


def _similarity(rows: Any) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None:
    if rows is None:
        return None
    found = np.array(rows, dtype=np.float64)
    if found.shape != (4, 4) or not np.isfinite(found).all() or np.abs(found[3] - (0, 0, 0, 1)).max() > 1e-6:
        raise ValueError("camera_from_mesh is no (4, 4) transform of finite numbers")
    scale = float(portable.cbrt([portable.det3(found[:3, :3])])[0])
    if not scale > 1e-9:
        raise ValueError("camera_from_mesh mirrors or flattens the mesh")
    rotation = found[:3, :3] / scale
    if np.abs(portable.matmul(rotation, rotation.T) - np.eye(3)).max() > 1e-3:
        raise ValueError("camera_from_mesh is no rotation with a scale")
    return found
