"""Small ONNX graphs with the inputs and outputs of the real networks, that compute what a test can know beforehand."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSET = 18


def save(path, nodes, outputs, *, constants=(), image=(1, 3, None, None), inputs=(), opset=OPSET):
    """Write a graph that takes `image`, or `inputs` (name, shape); `outputs` are (name, element type, shape)."""
    graph = helper.make_graph(
        nodes,
        "small",
        [helper.make_tensor_value_info(n, TensorProto.FLOAT, s) for n, s in inputs or [("image", image)]],
        [helper.make_tensor_value_info(*output) for output in outputs],
        [numpy_helper.from_array(np.asarray(value), name) for name, value in constants],
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=10), str(path))
    return path


def anything(*names):
    """Nodes that take the image, so that it is not unused, and add nothing to the first constant."""
    return [
        helper.make_node("ReduceMean", ["image"], ["mean"], keepdims=0),
        helper.make_node("Constant", [], ["zero"], value=numpy_helper.from_array(np.float32(0))),
        helper.make_node("Mul", ["mean", "zero"], ["nothing"]),
        *(helper.make_node("Add", [f"{name}_", "nothing"], [name]) for name in names),
    ]


def yolo(path, boxes, *, prototypes, scores, coefficients, side=64, **options):
    """A YOLOv8-seg graph that finds the same whatever it sees: boxes (N, 4) x, y, w, h, scores (N, classes)."""
    predictions = np.concatenate([boxes, scores, coefficients], axis=1).T[None].astype(np.float32)
    return save(
        path, anything("predictions", "prototypes"),
        [
            ("predictions", TensorProto.FLOAT, predictions.shape),
            ("prototypes", TensorProto.FLOAT, (1, *prototypes.shape)),
        ],
        constants=[("predictions_", predictions), ("prototypes_", prototypes[None].astype(np.float32))],
        image=(1, 3, side, side), **options,
    )  # fmt: skip


def dino(path, patch=14, extra=1, image=(1, 3, None, None)):
    """A graph of tokens: the mean colour of each patch after `extra` tokens of ones."""
    nodes = [
        helper.make_node("AveragePool", ["image"], ["pooled"], kernel_shape=[patch, patch], strides=[patch, patch]),
        helper.make_node("Reshape", ["pooled", "shape"], ["flat"]),
        helper.make_node("Transpose", ["flat"], ["patches"], perm=[0, 2, 1]),
        helper.make_node("Concat", ["extra", "patches"], ["tokens"], axis=1),
    ]
    constants = [("shape", np.array([1, 3, -1])), ("extra", np.ones((1, extra, 3), np.float32))]
    return save(path, nodes, [("tokens", TensorProto.FLOAT, (1, None, 3))], constants=constants, image=image)


def scores_by_color(path, image=(1, 3, None, None)):
    """A semantic graph of three classes, whose scores are the red, green and blue of the image."""
    node = helper.make_node("AveragePool", ["image"], ["scores"], kernel_shape=[4, 4], strides=[4, 4])
    return save(path, [node], [("scores", TensorProto.FLOAT, (image[0], 3, None, None))], image=image)


def queries(path, class_logits, mask_logits):
    """A OneFormer graph with the same queries whatever it sees."""
    return save(
        path,
        anything("classes", "masks"),
        [
            ("classes", TensorProto.FLOAT, (1, *class_logits.shape)),
            ("masks", TensorProto.FLOAT, (1, *mask_logits.shape)),
        ],
        constants=[("classes_", class_logits[None]), ("masks_", mask_logits[None])],
    )


def sam_pair(folder, *, version=1, radii=(2, 4, 8), ious=(0.95, 0.9, 0.5), low=16, batched=True):
    """Graphs of the SAM family whose masks are discs of `radii` (cells of `low`) around each prompt; side 4 * low."""
    folder.mkdir(exist_ok=True)
    num, side = None if batched else 1, 4 * low
    names = ["image_embeddings"] if version == 1 else ["image_embed", "high_res_feats_0"]
    nodes = [helper.make_node("ReduceMean", ["image"], [name], keepdims=1) for name in names]
    outputs = [(name, TensorProto.FLOAT, (1, 1, 1, 1)) for name in names]
    save(folder / "x.encoder.onnx", nodes, outputs, image=(1, 3, side, side))
    where = np.arange(low, dtype=np.float32) + 0.5
    constants = [
        ("x_at", where.reshape(1, 1, 1, low)), ("y_at", where.reshape(1, 1, low, 1)),
        ("squares", np.square(np.float32(radii)).reshape(1, -1, 1, 1)), ("ious_", np.float32([ious])),
        ("quarter", np.float32(0.25)), ("zero", np.float32(0)),
        *((name, np.array([i])) for i, name in enumerate(("first", "second", "third"))),
        ("shape", np.array([-1, 1, 1, 1])), ("column", np.array([-1, 1])),
    ]  # fmt: skip
    nodes = [
        helper.make_node("Slice", ["point_coords", "first", "second", "second"], ["prompt"]),
        helper.make_node("Mul", ["prompt", "quarter"], ["cell"]),
        helper.make_node("Slice", ["cell", "first", "second", "third"], ["x_"]),
        helper.make_node("Slice", ["cell", "second", "third", "third"], ["y_"]),
        helper.make_node("Reshape", ["x_", "shape"], ["x"]), helper.make_node("Reshape", ["y_", "shape"], ["y"]),
        helper.make_node("Sub", ["x_at", "x"], ["dx"]), helper.make_node("Sub", ["y_at", "y"], ["dy"]),
        helper.make_node("Mul", ["dx", "dx"], ["dx2"]), helper.make_node("Mul", ["dy", "dy"], ["dy2"]),
        helper.make_node("Add", ["dx2", "dy2"], ["off"]), helper.make_node("Sub", ["squares", "off"], ["inside"]),
        helper.make_node("Mul", [names[-1], "zero"], ["nothing"]),
        helper.make_node("Add", ["inside", "nothing"], ["low_res_masks" if version == 1 else "all"]),
        helper.make_node("Reshape", ["x", "column"], ["each"]), helper.make_node("Mul", ["each", "zero"], ["no_iou"]),
        helper.make_node("Add", ["ious_", "no_iou"], ["iou_predictions"]),
    ]  # fmt: skip
    prompts = [("point_coords", (num, None, 2)), ("point_labels", (num, None)), ("mask_input", (1, 1, low, low))]
    inputs = [*((name, (1, 1, 1, 1)) for name in names), *prompts]
    if version == 1:
        inputs += [("has_mask_input", (1,)), ("orig_im_size", (2,))]
    else:
        # As samexporter's: one flag a prompt, which it multiplies with masks along their width.
        inputs[-1:] = [("mask_input", (num, 1, low, low)), ("has_mask_input", (num,))]
        nodes.append(helper.make_node("Mul", ["has_mask_input", "mask_input"], ["given"]))
        nodes.append(helper.make_node("Add", ["all", "given"], ["masks"]))
    masks = ("low_res_masks" if version == 1 else "masks", TensorProto.FLOAT, (num, len(radii), low, low))
    outputs = [masks, ("iou_predictions", TensorProto.FLOAT, (num, len(radii)))]
    save(folder / "x.decoder.onnx", nodes, outputs, constants=constants, inputs=inputs)
    return folder
