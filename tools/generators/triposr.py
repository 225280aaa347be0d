"""TripoSR (github.com/VAST-AI-Research/TripoSR, code and weights MIT) as a generator: one image, no depth, no scale."""
# | what | its convention | ours |
# |---|---|---|
# | image | square RGB, the object 85 % of it, grey 0.5 around it | cut out here by the mask; rembg is not needed |
# | mesh | z up, +x towards the camera of the image, +y to its right | kept; `camera_from_mesh` says so |
# | size | as seen from 1.9 units away with 40 degrees across | from the mask and the median depth, as a first guess |
# | colours | float 0..1 per vertex, or none where a texture is baked | bytes |
# Set up (Linux, CUDA): `install triposr` beside this file; config.yaml and model.ckpt of stabilityai/TripoSR go into
# `weights/`.

import inspect
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path[:0] = [str(Path(__file__).resolve().parent), str(Path(__file__).resolve().parent / "TripoSR")]

from serving import Made, NoShapeError, View, serve, squared  # noqa: E402 -- beside this script

_FOREGROUND, _BACKGROUND = 0.85, 0.5
_DISTANCE, _HALF_ANGLE_RAD = 1.9, np.radians(20)
_RESOLUTION, _CHUNK = 256, 8192
# Rows are the camera's x right, y down, z forward in the mesh's axes.
CAMERA_FROM_MESH = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])


def load() -> tuple[Callable[[View], Made], dict[str, str]]:
    """Return what makes a mesh of a view, and what it is."""
    import torch
    from tsr.system import TSR

    device = "cuda:0" if torch.cuda.is_available() else "cpu"
    weights = str(Path(__file__).resolve().parent / "weights")
    model = TSR.from_pretrained(weights, config_name="config.yaml", weight_name="model.ckpt")
    model.renderer.set_chunk_size(_CHUNK)
    model.to(device)

    def make(view: View) -> Made:
        from PIL import Image

        image, side_px = squared(view, _FOREGROUND, _BACKGROUND)
        with torch.no_grad():
            codes = model([Image.fromarray(image)], device=device)
        # Since textures can be baked it must be told that vertex colours are wanted.
        wants = {"has_vertex_color": True} if "has_vertex_color" in _names(model.extract_mesh) else {}
        mesh = model.extract_mesh(codes, resolution=_RESOLUTION, **wants)[0]
        vertices = np.asarray(mesh.vertices)
        colors = np.asarray(mesh.visual.vertex_colors)[:, :3]
        return Made(vertices, np.asarray(mesh.faces), colors, camera_from_mesh(view, side_px))

    return make, {"model": "TripoSR", "device": device, "torch": str(torch.__version__)}


def _names(function: Callable[..., object]) -> set[str]:
    return set(inspect.signature(function).parameters)


def camera_from_mesh(view: View, side_px: float) -> np.ndarray:
    """Return (4, 4) where the mesh lies: turned as the image was taken, as large and far as mask and depth say."""
    depth = view.depth_m[view.mask & (view.depth_m > 0)]
    if len(depth) == 0:
        raise NoShapeError("no depth within the mask")
    middle_z = float(np.median(depth))
    across = 2 * _DISTANCE * np.tan(_HALF_ANGLE_RAD) * _FOREGROUND
    scale = side_px * middle_z / view.K[0, 0] / across
    rows, columns = np.nonzero(view.mask)
    column, row = (columns.min() + columns.max()) / 2, (rows.min() + rows.max()) / 2
    ray = np.array([(column - view.K[0, 2]) / view.K[0, 0], (row - view.K[1, 2]) / view.K[1, 1], 1.0])
    found = np.eye(4)
    found[:3, :3] = scale * CAMERA_FROM_MESH
    found[:3, 3] = middle_z * ray
    return found


if __name__ == "__main__":
    serve(load)
