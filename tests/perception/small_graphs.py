"""Small ONNX graphs with the inputs and outputs of the real networks, that compute what a test can know beforehand."""

from pathlib import Path
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 18


def save(path: Path, nodes, outputs, *, constants=(), image=(1, 3, None, None), opset=OPSET) -> Path:
    """Write a graph that takes `image`; `outputs` are (name, element type, shape)."""
    graph = helper.make_graph(
        nodes,
        "small",
        [helper.make_tensor_value_info("image", TensorProto.FLOAT, image)],
        [helper.make_tensor_value_info(*output) for output in outputs],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=10)
    onnx.save(model, str(path))
    return path


def _anything(*names):
    """Nodes that take the image, so that it is not unused, and add nothing to the first constant."""
    return [
        helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0),
        helper.make_node("Constant", [], ["zero"], value=numpy_helper.from_array(np.float32(0))),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        *(helper.make_node("Add", [f"{name}_", "nothing"], [name]) for name in names),
    ]


def yolo(path: Path, boxes, *, prototypes, scores, coefficients, side=64, **options) -> Path:
    """A YOLOv8-seg graph that finds the same whatever it sees: boxes (N, 4) x, y, w, h, scores (N, classes)."""
    predictions = np.concatenate([boxes, scores, coefficients], axis=1).T[None].astype(np.float32)
    return save(
        path,
        _anything("predictions", "prototypes"),
        [
            ("predictions", TensorProto.FLOAT, predictions.shape),
            ("prototypes", TensorProto.FLOAT, (1, *prototypes.shape)),
        ],
        constants=[("predictions_", predictions), ("prototypes_", prototypes[None].astype(np.float32))],
        image=(1, 3, side, side),
        **options,
    )


def dino(path: Path, patch=14, extra=1, image=(1, 3, None, None)) -> Path:
    """A graph of tokens: the mean colour of each patch after `extra` tokens of ones."""
    nodes = [
        helper.make_node("AveragePool", ["image"], ["pooled"], kernel_shape=[patch, patch], strides=[patch, patch]),
        helper.make_node("Reshape", ["pooled", "shape"], ["flat"]),
        helper.make_node("Transpose", ["flat"], ["patches"], perm=[0, 2, 1]),
        helper.make_node("Concat", ["extra", "patches"], ["tokens"], axis=1),
    ]
    constants = [("shape", np.array([1, 3, -1])), ("extra", np.ones((1, extra, 3), np.float32))]
    return save(path, nodes, [("tokens", TensorProto.FLOAT, (1, None, 3))], constants=constants, image=image)


def scores_by_color(path: Path, image=(1, 3, None, None)) -> Path:
    """A semantic graph of three classes, whose scores are the red, green and blue of the image."""
    node = helper.make_node("AveragePool", ["image"], ["scores"], kernel_shape=[4, 4], strides=[4, 4])
    return save(path, [node], [("scores", TensorProto.FLOAT, (1, 3, None, None))], image=image)


def queries(path: Path, class_logits, mask_logits) -> Path:
    """A OneFormer graph with the same queries whatever it sees."""
    return save(
        path,
        _anything("classes", "masks"),
        [
            ("classes", TensorProto.FLOAT, (1, *class_logits.shape)),
            ("masks", TensorProto.FLOAT, (1, *mask_logits.shape)),
        ],
        constants=[("classes_", class_logits[None]), ("masks_", mask_logits[None])],
    )
