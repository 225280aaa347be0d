"""FoundationPose (github.com/NVlabs/FoundationPose, code and weights for research only) as a refiner of poses."""
# | what | its convention | ours |
# |---|---|---|
# | camera, rgb | K (3, 3) float64, pixels; (H, W, 3) uint8, red first | as they are |
# | depth | (H, W) float32 metres along the optical axis; 0 (never NaN), and what is below 0.1 m, is none | as it is |
# | mask | (H, W) bool | as it is |
# | model | a trimesh in metres, in any frame; the package centres it and puts it back | as it is |
# | pose | `register` gives camera_from_mesh (4, 4) for columns, camera x right, y down, z forward | as it is |
# | failure | under 4 pixels of mask with depth: the identity as rotation, no error | looked for before and after |
# Set up (Linux, CUDA): `install foundationpose` beside this file. The folder `FoundationPose/weights` then holds
# 2023-10-28-18-33-37 (refiner) and 2024-01-11-20-02-45 (scorer).

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

_HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(_HERE), str(_HERE / "FoundationPose")]

from serving import Model, NoShapeError, View, array_of, serve_poses  # noqa: E402 -- beside this script

_ITERATIONS = 5
_MIN_PIXELS, _NEAREST_M = 4, 0.1
CAMERA_FROM_OPENCV = np.eye(3)


def load() -> tuple[Callable[[View, Model], np.ndarray], dict[str, str]]:
    """Return what finds the pose of a model in a view, and what it is."""
    import nvdiffrast.torch as dr
    import trimesh
    from estimater import FoundationPose, PoseRefinePredictor, ScorePredictor

    scorer, refiner, context = ScorePredictor(), PoseRefinePredictor(), dr.RasterizeCudaContext()

    def place(view: View, model: Model) -> np.ndarray:
        if (view.mask & (view.depth_m >= _NEAREST_M)).sum() < _MIN_PIXELS:
            raise NoShapeError(f"fewer than {_MIN_PIXELS} pixels of the mask have depth")
        mesh = trimesh.Trimesh(model.vertices, model.faces, vertex_colors=model.colors, process=False)
        estimator = FoundationPose(
            model_pts=mesh.vertices, model_normals=mesh.vertex_normals, mesh=mesh, scorer=scorer, refiner=refiner,
            glctx=context, debug=0, debug_dir=str(Path(tempfile.gettempdir()) / "foundationpose"),
        )  # fmt: skip
        depth = np.ascontiguousarray(view.depth_m, dtype=np.float32)
        pose = array_of(
            estimator.register(K=view.K, rgb=view.rgb, depth=depth, ob_mask=view.mask, iteration=_ITERATIONS)
        ).reshape(4, 4)
        if np.allclose(pose[:3, :3], np.eye(3), atol=1e-9):
            raise NoShapeError("it found too little depth, after its filters, to register the model")
        camera_from_mesh = np.array(pose, dtype=np.float64)
        camera_from_mesh[:3] = CAMERA_FROM_OPENCV @ camera_from_mesh[:3]
        return camera_from_mesh

    return place, {"model": "FoundationPose"}


if __name__ == "__main__":
    serve_poses(load)
