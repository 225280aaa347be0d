"""A graph of eight-bit convolutions run with NumPy's integers: what is exact here must come out of onnxruntime."""

import numpy as np
import onnx
from onnx import numpy_helper


def run_in_integers(path, inputs):
    """Return the output of a graph of QLinearConv, Resize by two and Concat for (1, C, H, W) bytes."""
    graph = onnx.load(path).graph
    values = {c.name: numpy_helper.to_array(c) for c in graph.initializer}
    values[graph.input[0].name] = inputs
    for node in graph.node:
        given = [values.get(name) for name in node.input]
        if node.op_type == "QLinearConv":
            attributes = {a.name: onnx.helper.get_attribute_value(a) for a in node.attribute}
            out = _convolved(given, attributes["strides"][0], attributes["pads"][0])
        elif node.op_type == "Resize":
            out = given[0].repeat(2, axis=2).repeat(2, axis=3)
        else:
            assert node.op_type == "Concat", node.op_type
            out = np.concatenate(given, axis=1)
        values[node.output[0]] = out
    return values[graph.output[0].name]


def _convolved(given, stride, pad):
    x, x_scale, x_zero, w, w_scales, w_zeros, y_scale, y_zero, bias = given
    assert not w_zeros.any()
    around = [(0, 0), (0, 0), (pad, pad), (pad, pad)]
    padded = np.pad(x.astype(np.int64) - int(x_zero), around)
    side = w.shape[2]
    height, width = (-(-(n + 2 * pad - side + 1) // stride) for n in x.shape[2:])
    sums = np.broadcast_to(bias.astype(np.int64)[None, :, None, None], (1, len(w), height, width)).copy()
    for dy in range(side):
        for dx in range(side):
            part = padded[0, :, dy : dy + stride * height : stride, dx : dx + stride * width : stride]
            sums[0] += np.einsum("oi,ihw->ohw", w[:, :, dy, dx].astype(np.int64), part)
    # A product of single precision and a rounding to even: no other float.
    scales = (x_scale * w_scales / y_scale).astype(np.float32)
    scaled = sums.astype(np.float32) * scales[None, :, None, None]
    return np.clip(np.rint(scaled) + np.float32(y_zero), 0, 255).astype(np.uint8)
