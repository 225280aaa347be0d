"""What every adapter needs: the protocol of a generator, the files of a job, and a GLB. Python, NumPy and Pillow alone.

Adapters run in environments of their own, and import nothing of hickory-stream.
"""

import contextlib
import json
import os
import struct
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class View:
    """The best view of an object: `rgb` (H, W, 3) uint8, `mask` (H, W) bool, `depth_m` (H, W) with 0 for none, `K`."""

    rgb: np.ndarray
    mask: np.ndarray
    depth_m: np.ndarray
    K: np.ndarray
    seed: int

    def points(self) -> np.ndarray:
        """Return (H, W, 3) camera points, x right, y down, z forward; NaN where there is no depth."""
        rows, columns = np.mgrid[: self.depth_m.shape[0], : self.depth_m.shape[1]]
        z = np.where(self.depth_m > 0, self.depth_m, np.nan)
        x, y = (columns - self.K[0, 2]) / self.K[0, 0] * z, (rows - self.K[1, 2]) / self.K[1, 1] * z
        return np.stack([x, y, z], axis=-1).astype(np.float32)


@dataclass(frozen=True)
class Made:
    """A mesh: `vertices` (V, 3), `faces` (F, 3), `colors` (V, 3) uint8 or None, `camera_from_mesh` (4, 4) or None."""

    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None = None
    camera_from_mesh: np.ndarray | None = None


@dataclass(frozen=True)
class Model:
    """A mesh of true size whose pose is asked for, in a frame of its own."""

    # `vertices` (V, 3) metres, `faces` (F, 3), `colors` (V, 3) uint8 or None.
    vertices: np.ndarray
    faces: np.ndarray
    colors: np.ndarray | None = None


class NoShapeError(Exception):
    """No shape can be made of this view."""


def serve(load: Callable[[], tuple[Callable[[View], Made], dict[str, str]]]) -> None:
    """Load a model, say what it is, and answer jobs with meshes until standard input ends."""
    _serve(load, answer)


def serve_poses(load: Callable[[], tuple[Callable[[View, Model], np.ndarray], dict[str, str]]]) -> None:
    """Load a model, say what it is, and answer jobs with poses until standard input ends."""
    _serve(load, answer_pose)


def _serve(load: Callable[[], tuple[Any, dict[str, str]]], answer_with: Callable[[Path, Any], None]) -> None:
    # Standard output belongs to the protocol: whatever a model prints goes to standard error.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    made, told = load()
    _say(answers, {"ready": True, **told})
    for line in sys.stdin:
        asked = json.loads(line)
        answer_with(Path(asked["folder"]), made)
        _say(answers, {"done": asked["job"]})


def _say(answers: Any, message: dict[str, Any]) -> None:
    answers.write(json.dumps(message, allow_nan=False) + "\n")
    answers.flush()


def answer(folder: Path, make: Callable[[View], Made]) -> None:
    """Do one job: read its view, and write the mesh, or why there is none."""
    job = json.loads((folder / "job.json").read_text())
    try:
        made = make(_shown(folder, job))
        if len(made.vertices) == 0 or len(made.faces) == 0:
            raise NoShapeError("an empty mesh")
    except NoShapeError as error:
        _refuse(folder, job, error)
        return
    (folder / "mesh.glb").write_bytes(glb(made))
    said: dict[str, Any] = {"job": job["job"]}
    if made.camera_from_mesh is not None:
        said["camera_from_mesh"] = np.asarray(made.camera_from_mesh, dtype=np.float64).tolist()
    (folder / "result.json").write_text(json.dumps(said, allow_nan=False))


def answer_pose(folder: Path, place: Callable[[View, Model], np.ndarray]) -> None:
    """Do one job: read its view and its model, and write camera_from_mesh, or why it is not known."""
    job = json.loads((folder / "job.json").read_text())
    try:
        with np.load(folder / "model.npz", allow_pickle=False) as content:
            model = Model(vertices=content["vertices"], faces=content["faces"], colors=content["colors"])
        camera_from_mesh = place(_shown(folder, job), model)
    except NoShapeError as error:
        _refuse(folder, job, error)
        return
    said = {"job": job["job"], "camera_from_mesh": np.asarray(camera_from_mesh, dtype=np.float64).tolist()}
    (folder / "result.json").write_text(json.dumps(said, allow_nan=False))


def _shown(folder: Path, job: dict[str, Any]) -> View:
    view = read_view(folder, job["seed"])
    if not view.mask.any():
        raise NoShapeError("an empty mask")
    return view


def _refuse(folder: Path, job: dict[str, Any], error: NoShapeError) -> None:
    (folder / "no_shape.json").write_text(json.dumps({"job": job["job"], "reason": str(error)}, allow_nan=False))


def read_view(folder: Path, seed: int) -> View:
    """Return the best view of a job."""
    from PIL import Image

    camera = json.loads((folder / "camera.json").read_text())
    return View(
        rgb=np.asarray(Image.open(folder / "rgb.png").convert("RGB")),
        mask=np.asarray(Image.open(folder / "mask.png").convert("L")) > 0,
        depth_m=np.load(folder / "depth.npy", allow_pickle=False),
        K=np.array([[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1.0]]),
        seed=seed,
    )


def glb(made: Made) -> bytes:
    """Return a GLB of one mesh of triangles in one buffer, without transforms."""
    vertices = np.ascontiguousarray(made.vertices, dtype="<f4")
    indices = np.ascontiguousarray(made.faces, dtype="<u4").reshape(-1)
    arrays = [(vertices.tobytes(), 34962), (indices.tobytes(), 34963)]
    low, high = vertices.min(axis=0).tolist(), vertices.max(axis=0).tolist()
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": len(vertices), "type": "VEC3", "min": low, "max": high},
        {"bufferView": 1, "componentType": 5125, "count": len(indices), "type": "SCALAR"},
    ]
    attributes = {"POSITION": 0}
    if made.colors is not None:
        alpha = np.full((len(made.colors), 1), 255, np.uint8)
        colors = np.hstack([np.asarray(made.colors, dtype=np.uint8), alpha])
        arrays.append((colors.tobytes(), 34962))
        attributes["COLOR_0"] = 2
        accessors.append(
            {"bufferView": 2, "componentType": 5121, "count": len(colors), "type": "VEC4", "normalized": True}
        )
    views, start = [], 0
    for content, target in arrays:
        views.append({"buffer": 0, "byteOffset": start, "byteLength": len(content), "target": target})
        start += len(content)
    binary = b"".join(content for content, _ in arrays)
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 1, "mode": 4}]}], "accessors": accessors,
        "bufferViews": views, "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    text = json.dumps(document, allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def array_of(values: Any) -> np.ndarray:
    """Return an array of a tensor on any device, or of an array."""
    with contextlib.suppress(AttributeError):
        values = values.detach().cpu().numpy()
    return np.asarray(values)


def squared(view: View, foreground: float, background: float) -> tuple[np.ndarray, float]:
    """Return a square (N, N, 3) uint8 image of the object alone, its longer side `foreground` of it; and that in px."""
    # `background` in 0..1 is the grey of what is not the object.
    rows, columns = np.nonzero(view.mask)
    top, left = rows.min(), columns.min()
    height, width = rows.max() + 1 - top, columns.max() + 1 - left
    side = max(height, width)
    whole = int(np.ceil(side / foreground))
    image = np.full((whole, whole, 3), round(255 * background), np.uint8)
    y, x = (whole - height) // 2, (whole - width) // 2
    part = np.s_[top : top + height, left : left + width]
    shown = np.where(view.mask[part][..., None], view.rgb[part], image[y : y + height, x : x + width])
    image[y : y + height, x : x + width] = shown
    return image, float(side)
