"""Small ONNX graphs with the names and shapes of FoundationPose's, and a view of an object that has no symmetry."""
# On this one object the graphs do what the networks learned: the refiner moves the rendered middle to the observed one
# and turns red and green parts together; the scorer counts differences. Exchanged inputs or axes lead elsewhere.

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from hickory_stream.pictures.ray_caster import ray_caster

_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
# Nothing is blue: with blue first there would be nothing to turn by.
_COLORS = np.array([[60, 60, 0], [255, 0, 0], [0, 255, 0], [20, 20, 0]], np.uint8)
_K = np.array([[400.0, 0, 160], [0, 400.0, 120], [0, 0, 1]])
# A corner that faces the camera, and three arms of different lengths away from it.
_TURN = trimesh.geometry.align_vectors([1, 0.9, 1.2], [0, 0, 1])[:3, :3]
_CORNERS = np.array([0.06, -0.05, 1.1]) + np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.25]]) @ _TURN.T
_OWN_FROM_CAMERA = trimesh.transformations.euler_matrix(2.1, 0.5, -1.3)[:3, :3]
_OWN_SHIFT = np.array([0.4, -0.2, 0.7])
_GAIN = 30.0


def graph_fault(module: Any) -> str:
    """Return the fault of the adapter of the ONNX files, "" for none; `module` is the adapter."""
    own = _CORNERS @ _OWN_FROM_CAMERA.T + _OWN_SHIFT
    with TemporaryDirectory() as temporary:
        (Path(temporary) / "weights").mkdir()
        write_graphs(Path(temporary) / "weights")
        module._HERE = Path(temporary)
        some = _some_of(module.rotations())
        module.rotations = lambda: some
        place, about = module.load()
        found = place(_view(module), module.Model(vertices=own, faces=_FACES, colors=_COLORS))
    if not about.get("model"):
        return "it does not say which model it is"
    off_m = float(np.abs(own @ found[:3, :3].T + found[:3, 3] - _CORNERS).max())
    return "" if off_m < 0.02 else f"the model is {off_m:.3f} m off its place"


def _some_of(turns: NDArray[np.float64]) -> NDArray[np.float64]:
    likeness = np.einsum("nij,ij->n", turns, _OWN_FROM_CAMERA.T)
    return turns[np.argsort(-likeness)[[0, 60]]]


def _view(module: Any) -> Any:
    rows, columns = np.mgrid[:240, :320]
    rays = np.zeros((rows.size, 6), np.float32)
    rays[:, 3:] = np.column_stack([columns.ravel(), rows.ravel(), np.ones(rows.size)]) @ np.linalg.inv(_K).T
    caster = ray_caster()
    caster.add(_CORNERS.astype(np.float32), _FACES.astype(np.int32))
    found = caster.cast(rays)
    mask = np.isfinite(found.t)
    normals = trimesh.Trimesh(_CORNERS, _FACES, process=False).face_normals
    areas = trimesh.Trimesh(_CORNERS, _FACES, process=False).area_faces
    at_corner = np.array([(normals * areas[:, None])[(_FACES == i).any(axis=1)].sum(axis=0) for i in range(4)])
    facing = np.maximum(-at_corner[:, 2] / np.linalg.norm(at_corner, axis=1), 0)
    u, v = found.uv[mask].T
    shares = np.column_stack([1 - u - v, u, v])
    hit = _FACES[found.triangle[mask]]
    light = 0.8 + 0.5 * (shares * facing[hit]).sum(axis=1)
    rgb = np.zeros((rows.size, 3), np.uint8)
    rgb[mask] = np.minimum((shares[..., None] * _COLORS[hit]).sum(axis=1) * light[:, None], 255).round()
    depth = np.where(mask, found.t, 0).astype(np.float32).reshape(rows.shape)
    return module.View(rgb=rgb.reshape(240, 320, 3), mask=mask.reshape(rows.shape), depth_m=depth, K=_K, seed=1)


# ---- graphs ---------------------------------------------------------------------------------------------------------


class _Graph:
    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: Any, kind: type[np.generic] = np.int64) -> str:
        from onnx import numpy_helper

        self.constants.append(numpy_helper.from_array(np.asarray(value, kind), f"constant{len(self.constants)}"))
        return str(self.constants[-1].name)

    def of(self, kind: str, *inputs: str, named: str = "", **attributes: Any) -> str:
        from onnx import helper

        name = named or f"{kind}{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def part(self, of: str, first: int, end: int) -> str:
        return self.of("Slice", of, self.constant([first]), self.constant([end]), self.constant([3]))

    def middle(self, xyz: str, weight: str) -> str:
        axes = self.constant([1, 2])
        total = self.of("ReduceSum", self.of("Mul", xyz, weight), axes, keepdims=0)
        weights = self.of("ReduceSum", weight, axes, keepdims=0)
        return self.of("Div", total, self.of("Max", weights, self.constant(1e-6, np.float32)))

    def save(self, path: Path, outputs: Sequence[tuple[str, Sequence[Any]]]) -> None:
        import onnx
        from onnx import TensorProto, helper

        kind = TensorProto.FLOAT
        taken = [helper.make_tensor_value_info(name, kind, ["N", 160, 160, 6]) for name in ("input1", "input2")]
        given = [helper.make_tensor_value_info(name, kind, shape) for name, shape in outputs]
        graph = helper.make_graph(self.nodes, "small", taken, given, self.constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
        onnx.save(model, str(path))


def write_graphs(folder: Path) -> None:
    """Write refine_model.onnx and score_model.onnx."""
    refiner = _Graph()
    rendered, observed = (_middles(refiner, name) for name in ("input1", "input2"))
    refiner.of("Sub", observed[0], rendered[0], named="output1")
    torques = [_cross(refiner, a, b) for a, b in zip(rendered[1:], observed[1:], strict=True)]
    # Its turns are for rows, as those of the real one: the opposite of what takes columns there.
    refiner.of("Mul", refiner.of("Sum", *torques), refiner.constant(-_GAIN, np.float32), named="output2")
    refiner.save(folder / "refine_model.onnx", [("output1", ["N", 3]), ("output2", ["N", 3])])
    scorer = _Graph()
    apart = scorer.of("Abs", scorer.of("Sub", "input1", "input2"))
    mean = scorer.of("ReduceMean", apart, scorer.constant([1, 2, 3]), keepdims=0)
    scorer.of("Neg", scorer.of("Unsqueeze", mean, scorer.constant([0])), named="output1")
    scorer.save(folder / "score_model.onnx", [("output1", [1, "N"])])


def _middles(graph: _Graph, crop: str) -> list[str]:
    xyz = graph.part(crop, 3, 6)
    size = graph.of("ReduceSum", graph.of("Abs", xyz), graph.constant([3]))
    is_surface = graph.of("Cast", graph.of("Greater", size, graph.constant(0, np.float32)), to=1)
    whole = graph.middle(xyz, is_surface)
    weights = [graph.of("Mul", graph.part(crop, i, i + 1), is_surface) for i in range(2)]
    return [whole, *(graph.of("Sub", graph.middle(xyz, weight), whole) for weight in weights)]


def _cross(graph: _Graph, a: str, b: str) -> str:
    def rolled(of: str, order: list[int]) -> str:
        return graph.of("Gather", of, graph.constant(order), axis=1)

    forth = graph.of("Mul", rolled(a, [1, 2, 0]), rolled(b, [2, 0, 1]))
    back = graph.of("Mul", rolled(a, [2, 0, 1]), rolled(b, [1, 2, 0]))
    return graph.of("Sub", forth, back)
