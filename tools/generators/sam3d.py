"""SAM 3D Objects (github.com/facebookresearch/sam-3d-objects, SAM licence, weights gated) as a generator with depth."""
# | what | its convention | ours |
# |---|---|---|
# | image, mask | (H, W, 3) uint8, (H, W) bool | as they are |
# | pointmap | (H, W, 3) metres in PyTorch3D's camera: x left, y up, z forward | x and y change their signs |
# | mesh | `glb`: y up, the one export that is turned; the pose belongs to the z-up Gaussians | turned back to z up |
# | rotation | quaternion w, x, y, z; for rows: p' = (s p) R + t, in PyTorch3D's camera | transposed, signs changed |
# | scale | three equal numbers; may be wrong although depth was given | placement decides |
# Set up (Linux, CUDA 12.1): `install sam3d` beside this file, then its doc/setup.md (Python 3.11, torch 2.5.1, a conda
# environment: without CONDA_PREFIX its inference.py does not import); ask for the weights and put them into
# `sam-3d-objects/checkpoints/hf`. The command of the TOML is the python of that environment.

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

_HERE = Path(__file__).resolve().parent
_REPOSITORY = _HERE / "sam-3d-objects"
sys.path[:0] = [str(_HERE), str(_REPOSITORY / "notebook"), str(_REPOSITORY)]

from serving import Made, NoShapeError, View, array_of, serve  # noqa: E402 -- beside this script

_SEEDS = 1 << 31
_OPENCV_FROM_PYTORCH3D = np.diag([-1.0, -1.0, 1.0])
# Its export writes rows v @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]: (x, y, z) becomes (x, z, -y); this is the way back.
_Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])


def load() -> tuple[Callable[[View], Made], dict[str, str]]:
    """Return what makes a mesh of a view, and what it is."""
    os.environ.setdefault("CONDA_PREFIX", sys.prefix)
    import torch
    from inference import Inference

    model = Inference(str(_REPOSITORY / "checkpoints" / "hf" / "pipeline.yaml"), compile=False)

    def make(view: View) -> Made:
        if not (view.mask & (view.depth_m > 0)).any():
            raise NoShapeError("no depth within the mask")
        pointmap = torch.from_numpy(view.points() * np.array([-1, -1, 1], np.float32))
        output = model(view.rgb, view.mask, seed=view.seed % _SEEDS, pointmap=pointmap)
        mesh = output["glb"]
        if mesh is None:
            raise NoShapeError("the model gave no mesh")
        vertices = np.asarray(mesh.vertices) @ _Z_UP_FROM_Y_UP.T
        return Made(vertices, np.asarray(mesh.faces), _colors(mesh), camera_from_mesh(output))

    return make, {"model": "SAM 3D Objects", "torch": str(torch.__version__)}


def camera_from_mesh(output: dict[str, Any]) -> np.ndarray:
    """Return (4, 4), from the z-up mesh to OpenCV's camera."""
    w, x, y, z = array_of(output["rotation"]).reshape(-1)[:4]
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    scale = float(array_of(output["scale"]).reshape(-1).mean())
    found = np.eye(4)
    # PyTorch3D multiplies rows from the left: for columns its matrix is transposed.
    found[:3, :3] = scale * _OPENCV_FROM_PYTORCH3D @ rotation.T
    found[:3, 3] = _OPENCV_FROM_PYTORCH3D @ array_of(output["translation"]).reshape(-1)[:3]
    return found


def _colors(mesh: Any) -> np.ndarray | None:
    colors = getattr(getattr(mesh, "visual", None), "vertex_colors", None)
    return None if colors is None or len(colors) != len(mesh.vertices) else np.asarray(colors)[:, :3]


if __name__ == "__main__":
    serve(load)
