"""From the trained network to a graph in eight bits whose every sum is exact."""
# Batch normalisation is folded in. Activations are bytes from 0 on: cutting at 0 is the ReLU; joined tensors share a
# scale. Weights have seven bits: processors without VNNI add pairs in sixteen bits, and 2 x 255 x 63 < 32768.

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from hickory_stream.perception.affinity.pixel_inputs import NUM_INPUTS, UNIT, ZERO
from hickory_stream.perception.affinity.pixel_network import NUM_OUTPUTS, ODDS_UNIT, ODDS_ZERO
from tools.network_training.model import AffinityNet, Layer, inputs_of

_MOST_WEIGHT = 63
_OPSET, _IR_VERSION = 18, 10


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Folded:
    """A convolution with its normalisation: `weights` (O, I, k, k) and `bias` (O,) in float64."""

    weights: NDArray[np.float64]
    bias: NDArray[np.float64]
    stride: int


def export(net: AffinityNet, inputs: Sequence[NDArray[np.uint8]], path: Path) -> None:
    """Write the network in eight bits, its scales taken from (NUM_INPUTS, H, W) `inputs`."""
    scales = _scales(net, inputs)
    graph = _Graph()
    levels = len(net.down)
    name, scale = "inputs", (1 / UNIT, ZERO)
    kept: list[str] = []
    for i in range(levels):
        after = (scales[i], 0)
        name = graph.convolution(f"down{i}", name, scale, _folded(net.down[i]), (scales["down", i], 0))
        name = graph.convolution(f"same{i}", name, (scales["down", i], 0), _folded(net.same[i]), after)
        kept.append(name)
        scale = after
    for i in reversed(range(levels - 1)):
        # What comes from below and what was kept at this level share the scale of the level.
        name = graph.enlarged_and_joined(f"join{i}", name, kept[i])
        after = (scales[i - 1] if i > 0 else scales["up", 0], 0)
        name = graph.convolution(f"up{i}", name, (scales[i], 0), _folded(net.up[i]), after)
    head = Folded(weights=net.head.weight.detach().double().numpy(), bias=_array(net.head.bias), stride=1)
    graph.convolution("odds", name, (scales["up", 0], 0), head, (1 / ODDS_UNIT, ODDS_ZERO))
    path.write_bytes(graph.model().SerializeToString())


class _Graph:
    def __init__(self) -> None:
        self._nodes: list[onnx.NodeProto] = []
        self._constants: list[onnx.TensorProto] = []
        self._constant("twice", np.array([1, 1, 2, 2], dtype=np.float32))

    def convolution(
        self, name: str, source: str, before: tuple[float, int], folded: Folded, after: tuple[float, int]
    ) -> str:
        # The scales that are in the file: what is said of weights and bias holds for them exactly.
        x_scale, y_scale = np.float32(before[0]), np.float32(after[0])
        most = np.abs(folded.weights).max(axis=(1, 2, 3))
        w_scales = (np.maximum(most, 1e-8) / _MOST_WEIGHT).astype(np.float32)
        weights = np.rint(folded.weights / w_scales.astype(np.float64)[:, None, None, None])
        bias = np.rint(folded.bias / (np.float64(x_scale) * w_scales.astype(np.float64)))
        inputs = [
            source, self._constant(f"{name}_x_scale", x_scale), self._constant(f"{name}_x_zero", np.uint8(before[1])),
            self._constant(f"{name}_weights", np.clip(weights, -_MOST_WEIGHT, _MOST_WEIGHT).astype(np.int8)),
            self._constant(f"{name}_w_scales", w_scales),
            self._constant(f"{name}_w_zeros", np.zeros(len(w_scales), dtype=np.int8)),
            self._constant(f"{name}_y_scale", y_scale), self._constant(f"{name}_y_zero", np.uint8(after[1])),
            self._constant(f"{name}_bias", np.clip(bias, -(2**30), 2**30).astype(np.int32)),
        ]  # fmt: skip
        side = folded.weights.shape[2]
        self._nodes.append(
            helper.make_node(
                "QLinearConv",
                inputs,
                [name],
                name=name,
                kernel_shape=[side, side],
                strides=[folded.stride] * 2,
                pads=[side // 2] * 4,
            )
        )
        return name

    def enlarged_and_joined(self, name: str, below: str, beside: str) -> str:
        self._nodes.append(
            helper.make_node(
                "Resize",
                [below, "", "twice"],
                [f"{name}_large"],
                name=f"{name}_large",
                mode="nearest",
                coordinate_transformation_mode="asymmetric",
                nearest_mode="floor",
            )
        )
        self._nodes.append(helper.make_node("Concat", [f"{name}_large", beside], [name], name=name, axis=1))
        return name

    def model(self) -> onnx.ModelProto:
        told = helper.make_tensor_value_info
        graph = helper.make_graph(
            self._nodes, "affinities", [told("inputs", TensorProto.UINT8, [1, NUM_INPUTS, "height", "width"])],
            [told("odds", TensorProto.UINT8, [1, NUM_OUTPUTS, "half_height", "half_width"])], self._constants,
        )  # fmt: skip
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)])
        model.ir_version = _IR_VERSION
        onnx.checker.check_model(model, full_check=True)
        return model

    def _constant(self, name: str, value: NDArray[np.generic] | np.generic) -> str:
        self._constants.append(numpy_helper.from_array(np.asarray(value), name))
        return name


def _folded(layer: Layer) -> Folded:
    norm = layer.norm
    gain = _array(norm.weight) / np.sqrt(_array(norm.running_var) + norm.eps)
    weights = layer.conv.weight.detach().double().numpy() * gain[:, None, None, None]
    bias = _array(norm.bias) - _array(norm.running_mean) * gain
    return Folded(weights=weights, bias=bias, stride=layer.conv.stride[0])


def _array(tensor: torch.Tensor) -> NDArray[np.float64]:
    return np.asarray(tensor.detach().double().numpy())


def _scales(net: AffinityNet, inputs: Sequence[NDArray[np.uint8]]) -> dict[int | tuple[str, int], float]:
    # Return what one step of a byte is worth: for level i what is kept and enlarged there, and for other tensors. The
    # greatest activations are cut: a few in ten thousand may be over the range, for which all others are finer.
    found: dict[tuple[str, int], list[float]] = {}

    def watch(key: tuple[str, int]):  # type: ignore[no-untyped-def]
        def hook(module: torch.nn.Module, given: tuple[torch.Tensor, ...], output: torch.Tensor) -> None:
            found.setdefault(key, []).append(float(np.quantile(output.numpy(), 0.9997)))

        return hook

    layers = [("down", net.down), ("same", net.same), ("up", net.up)]
    handles = [m.register_forward_hook(watch((kind, i))) for kind, all_of in layers for i, m in enumerate(all_of)]
    with torch.no_grad():
        for one in inputs:
            net(inputs_of(torch.from_numpy(one[None])))
    for handle in handles:
        handle.remove()
    greatest = {key: max(float(np.mean(values)), 1e-3) for key, values in found.items()}
    scales: dict[int | tuple[str, int], float] = {key: value / 255 for key, value in greatest.items()}
    levels = len(net.down)
    for i in range(levels):
        below = ("up", i + 1) if i + 1 < levels - 1 else ("same", levels - 1)
        scales[i] = max(greatest["same", i], greatest[below] if i < levels - 1 else greatest["same", levels - 1]) / 255
    # The lowest level is enlarged beside what was kept of the one above it.
    scales[levels - 1] = scales[levels - 2]
    return scales
