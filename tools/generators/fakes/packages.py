"""Fakes of the official packages of the generators: their names and signatures, and one object without symmetry."""
# The object is known in the camera's axes. Each fake returns it in the axes of its package, by that package's own
# formulas as read from its sources, so that an adapter that turns one axis wrongly puts it elsewhere.

import importlib.util
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from tools.generators.fakes.graphs import graph_fault

FOLDER = Path(__file__).resolve().parents[1]
ADAPTERS = ("triposr", "trellis", "sam3d")
REFINERS = ("foundationpose", "foundationpose_onnx")
K = np.array([[200.0, 0, 40], [0, 200.0, 30], [0, 0, 1]])
MIDDLE = np.array([0.05, -0.04, 2.0])
# A corner at the middle, and arms of different lengths to the right, down and forward.
POINTS = MIDDLE + np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
COLORS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [51, 102, 153]], np.uint8)
# `register` has a parameter of that name.
_K = K
# The size that TripoSR's default camera gives an object that fills 85 % of its image.
_TRIPOSR_UNITS = 2 * 1.9 * np.tan(np.radians(20)) * 0.85
_QUATERNION = np.array([0.5, 0.1, -0.7, 0.2]) / np.linalg.norm([0.5, 0.1, -0.7, 0.2])
_SCALE, _SHIFT = 0.37, np.array([0.02, 0.11, 1.9])


class Tensor:
    """As much of a torch tensor as the adapters use."""

    def __init__(self, values: NDArray[Any]) -> None:
        self._values = values

    def detach(self) -> "Tensor":
        return self

    cpu = detach

    def numpy(self) -> NDArray[Any]:
        return self._values


def fake_torch() -> ModuleType:
    torch: Any = ModuleType("torch")
    torch.__version__ = "0.fake"
    torch.cuda = SimpleNamespace(is_available=lambda: False)
    torch.no_grad = nullcontext
    torch.from_numpy = Tensor
    return torch  # type: ignore[no-any-return]


class TSR:
    """`tsr.system.TSR` of TripoSR."""

    def __init__(self) -> None:
        self.renderer = SimpleNamespace(set_chunk_size=lambda chunk_size: None)

    @classmethod
    def from_pretrained(cls, pretrained_model_name_or_path: str, config_name: str, weight_name: str) -> "TSR":
        name = Path(pretrained_model_name_or_path).name
        assert (name, config_name, weight_name) == ("weights", "config.yaml", "model.ckpt")
        return cls()

    def to(self, device: str) -> None:
        assert device in ("cpu", "cuda:0")

    def __call__(self, image: Any, device: str) -> str:
        (picture,) = image
        assert device == "cpu" and picture.mode == "RGB"
        assert picture.width == picture.height and picture.getpixel((0, 0)) == (128, 128, 128)
        return "codes"

    def extract_mesh(
        self, scene_codes: str, has_vertex_color: bool, resolution: int = 256, threshold: float = 25.0
    ) -> list[trimesh.Trimesh]:
        assert scene_codes == "codes" and has_vertex_color
        right, down, forward = (POINTS - POINTS.mean(axis=0)).T
        # Its cameras look from +x at azimuth 0, z up; the longer side, 0.3 m, fills the object's share of the image.
        vertices = np.column_stack([-forward, right, -down]) * _TRIPOSR_UNITS / 0.3
        return [trimesh.Trimesh(vertices, FACES, vertex_colors=COLORS, process=False)]


class TrellisImageTo3DPipeline:
    """`trellis.pipelines.TrellisImageTo3DPipeline`."""

    @staticmethod
    def from_pretrained(path: str) -> "TrellisImageTo3DPipeline":
        assert Path(path).name == "TRELLIS-image-large"
        return TrellisImageTo3DPipeline()

    def cuda(self) -> None:
        pass

    def run(
        self, image: Any, num_samples: int = 1, seed: int = 42, sparse_structure_sampler_params: Any = None,
        slat_sampler_params: Any = None, formats: tuple[str, ...] | list[str] = ("mesh", "gaussian", "radiance_field"),
        preprocess_image: bool = True,
    ) -> dict[str, list[Any]]:  # fmt: skip
        assert image.mode == "RGBA" and set(np.asarray(image)[..., 3].ravel()) == {0, 255}
        assert list(formats) == ["mesh"] and preprocess_image and 0 <= seed < 1 << 31
        attributes = Tensor(np.hstack([COLORS / 255, np.zeros((4, 3))]))
        right, down, forward = (POINTS - MIDDLE).T
        vertices = Tensor(np.column_stack([right, forward, -down]))
        return {"mesh": [SimpleNamespace(vertices=vertices, faces=Tensor(FACES), vertex_attrs=attributes)]}


class Inference:
    """`inference.Inference` in the notebook folder of SAM 3D Objects."""

    def __init__(self, config_file: str, compile: bool = False) -> None:
        assert Path(config_file).name == "pipeline.yaml" and not compile

    def __call__(self, image: Any, mask: Any, seed: int | None = None, pointmap: Any = None) -> dict[str, Any]:
        assert image.dtype == np.uint8 and mask.dtype == bool
        points = pointmap.numpy()
        row, column = np.argwhere(mask)[0]
        # PyTorch3D's camera: x left, y up.
        z = points[row, column, 2]
        expected = np.array([-(column - K[0, 2]) / K[0, 0], -(row - K[1, 2]) / K[1, 1], 1]) * z
        assert np.allclose(points[row, column], expected, atol=1e-5)
        in_pytorch3d = POINTS * (-1, -1, 1)
        # quaternion_to_matrix, whose rows are multiplied from the left: p' = (s p) R + t.
        turn = trimesh.transformations.quaternion_matrix(_QUATERNION)[:3, :3]
        z_up = (in_pytorch3d - _SHIFT) @ np.linalg.inv(turn) / _SCALE
        y_up = z_up @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
        return {
            "glb": trimesh.Trimesh(y_up, FACES, vertex_colors=COLORS, process=False),
            "rotation": Tensor(_QUATERNION[None]),
            "translation": Tensor(_SHIFT[None]),
            "scale": Tensor(np.full((1, 3), _SCALE)),
        }


class ScorePredictor:
    """`ScorePredictor` as `estimater` has it."""


class PoseRefinePredictor:
    """`PoseRefinePredictor` as `estimater` has it."""


class RasterizeCudaContext:
    """`nvdiffrast.torch.RasterizeCudaContext`."""


class FoundationPose:
    """`estimater.FoundationPose`: it knows the corners of the one object."""

    def __init__(
        self, model_pts: Any, model_normals: Any, symmetry_tfs: Any = None, mesh: Any = None,
        scorer: ScorePredictor | None = None, refiner: PoseRefinePredictor | None = None, glctx: Any = None,
        debug: int = 0, debug_dir: str = "",
    ) -> None:  # fmt: skip
        assert isinstance(scorer, ScorePredictor) and isinstance(refiner, PoseRefinePredictor)
        assert isinstance(glctx, RasterizeCudaContext) and symmetry_tfs is None
        assert model_normals.shape == model_pts.shape and debug == 0 and debug_dir
        self.model_center = (model_pts.min(axis=0) + model_pts.max(axis=0)) / 2
        self.mesh = mesh.copy()
        self.mesh.vertices = mesh.vertices - self.model_center

    def register(
        self, K: Any, rgb: Any, depth: Any, ob_mask: Any, ob_id: Any = None, glctx: Any = None, iteration: int = 5
    ) -> Any:
        assert rgb.dtype == np.uint8 and depth.dtype == np.float32
        assert np.isfinite(depth).all() and np.array_equal(K, _K)
        pose = np.eye(4)
        if ((depth >= 0.1) & (ob_mask > 0)).sum() < 4:
            return pose
        # The rotation between the corners, by Kabsch, then the shift from the model to its middle.
        own, there = self.mesh.vertices - self.mesh.vertices.mean(axis=0), POINTS - POINTS.mean(axis=0)
        left, _, right = np.linalg.svd(own.T @ there)
        pose[:3, :3] = (left @ np.diag([1, 1, np.sign(np.linalg.det(left @ right))]) @ right).T
        pose[:3, 3] = POINTS.mean(axis=0) - pose[:3, :3] @ self.mesh.vertices.mean(axis=0)
        to_center = np.eye(4)
        to_center[:3, 3] = -self.model_center
        return Tensor(pose @ to_center)


_PACKAGES = {
    "tsr.system": (TSR,), "trellis.pipelines": (TrellisImageTo3DPipeline,), "inference": (Inference,),
    "nvdiffrast.torch": (RasterizeCudaContext,), "estimater": (FoundationPose, ScorePredictor, PoseRefinePredictor),
}  # fmt: skip


@contextmanager
def faked(name: str) -> Iterator[ModuleType]:
    """Yield an adapter as a module, with the fake of its package in place."""
    modules: dict[str, Any] = {"torch": fake_torch()}
    for path, members in _PACKAGES.items():
        for package in path.split("."):
            modules[package] = ModuleType(package)
        modules[path] = ModuleType(path)
        vars(modules[path]).update({member.__name__: member for member in members})
    modules["torch"] = fake_torch()
    before, search = {key: sys.modules.get(key) for key in [*modules, "serving"]}, list(sys.path)
    sys.modules.update(modules)
    try:
        spec = importlib.util.spec_from_file_location(f"adapter_{name}", FOLDER / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        yield module
    finally:
        sys.path[:] = search
        for key, module_before in before.items():
            sys.modules.pop(key, None)
            if module_before is not None:
                sys.modules[key] = module_before


def shown_view(module: Any) -> Any:
    """Return the view of the fakes' object: a rectangle at a depth of 2 m."""
    mask = np.zeros((60, 80), bool)
    mask[25:45, 45:75] = True
    rgb = np.full((60, 80, 3), 40, np.uint8)
    return module.View(rgb=rgb, mask=mask, depth_m=np.where(mask, np.float32(2), np.float32(0)), K=K, seed=123)


def adapter_fault(name: str) -> str:
    with faked(name) as module:
        make, about = module.load()
        made = make(shown_view(module))
    if not about.get("model"):
        return "it does not say which model it is"
    if made.colors is None or not np.array_equal(made.colors, COLORS):
        return "its colours are others"
    if not np.array_equal(made.faces, FACES):
        return "its faces are others"
    arms, true_arms = (made.vertices[1:] - made.vertices[0]).astype(np.float64), POINTS[1:] - POINTS[0]
    if np.linalg.det(arms) * np.linalg.det(true_arms) <= 0:
        return "the mesh is mirrored"
    if name == "trellis":
        # No pose is given: the mesh stands as the package has it, z up.
        return "" if np.allclose(arms, [[0.3, 0, 0], [0, 0, -0.2], [0, 0.1, 0]]) else "the mesh was turned"
    found = arms @ made.camera_from_mesh[:3, :3].T
    if not np.allclose(found, true_arms, atol=1e-6 if name == "sam3d" else 0.01):
        return f"its arms are at {found.round(3).tolist()}"
    placed = made.vertices @ made.camera_from_mesh[:3, :3].T + made.camera_from_mesh[:3, 3]
    off_m = float(np.abs(placed.mean(axis=0) - POINTS.mean(axis=0)).max())
    return "" if off_m < (1e-6 if name == "sam3d" else 0.2) else f"it is {off_m:.3f} m off its place"


def refiner_fault(name: str) -> str:
    """Return the fault of a refiner of poses against the fake of its package, "" for none."""
    turn = trimesh.transformations.quaternion_matrix(_QUATERNION)[:3, :3]
    with faked(name) as module:
        if name == "foundationpose_onnx":
            return graph_fault(module)
        place, about = module.load()
        own = (POINTS - MIDDLE) @ turn + _SHIFT
        found = place(shown_view(module), module.Model(vertices=own, faces=FACES))
    if not about.get("model"):
        return "it does not say which model it is"
    off_m = float(np.abs(own @ found[:3, :3].T + found[:3, 3] - POINTS).max())
    return "" if off_m < 1e-6 else f"the model is {off_m:.3f} m off its place"
