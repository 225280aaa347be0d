"""A small image-text pair in the files of a published one: what it knows of a picture is its mean colour."""

import json
import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper
from tokenizers import Tokenizer
from tokenizers.models import WordLevel
from tokenizers.pre_tokenizers import Whitespace

SIDE_PX = 8
# What a word means: red, green, blue. "Window" is blue and "mug" is red; the others say nothing in particular.
WORDS = {
    "[PAD]": (0, 0, 0), "[UNK]": (0.1, 0.1, 0.1), **dict.fromkeys(("a", "photo", "of", "."), (0, 0, 0)),
    **dict.fromkeys(("object", "thing", "stuff", "texture"), (1, 1, 1)), "window": (0, 0, 1), "coffee": (0.5, 0.1, 0.1),
    "mug": (1, 0, 0),
}  # fmt: skip
PREPROCESSING = {
    "size": {"shortest_edge": SIDE_PX}, "do_center_crop": True, "crop_size": {"height": SIDE_PX, "width": SIDE_PX},
    "resample": 3, "image_mean": [0.0, 0.0, 0.0], "image_std": [1.0, 1.0, 1.0],
}  # fmt: skip


def write_pair(folder, *, length=None, with_mask=True, output="embeds"):
    """Write the files of a pair; `length` is how many tokens the text graph takes, None: any."""
    folder.mkdir(parents=True, exist_ok=True)
    _save(
        folder / "vision_model.onnx",
        [helper.make_node("ReduceMean", ["pixel_values", "axes"], [f"image_{output}"], keepdims=0)],
        [helper.make_tensor_value_info("pixel_values", TensorProto.FLOAT, (1, 3, SIDE_PX, SIDE_PX))],
        helper.make_tensor_value_info(f"image_{output}", TensorProto.FLOAT, (1, 3)),
        {"axes": np.array([2, 3])},
    )
    nodes = [
        helper.make_node("Gather", ["words", "input_ids"], ["each"]),
        helper.make_node("ReduceSum", ["each", "axis"], [f"text_{output}"], keepdims=0),
    ]
    inputs = [helper.make_tensor_value_info("input_ids", TensorProto.INT64, (1, length or "tokens"))]
    if with_mask:
        inputs.append(helper.make_tensor_value_info("attention_mask", TensorProto.INT64, (1, length or "tokens")))
        nodes.insert(0, helper.make_node("Identity", ["attention_mask"], ["unused"]))
    _save(
        folder / "text_model.onnx", nodes, inputs,
        helper.make_tensor_value_info(f"text_{output}", TensorProto.FLOAT, (1, 3)),
        {"words": np.array(list(WORDS.values()), np.float32), "axis": np.array([1])},
    )  # fmt: skip
    tokenizer = Tokenizer(WordLevel({word: i for i, word in enumerate(WORDS)}, unk_token="[UNK]"))
    tokenizer.pre_tokenizer = Whitespace()
    tokenizer.save(str(folder / "tokenizer.json"))
    (folder / "tokenizer_config.json").write_text(json.dumps({"model_max_length": 12, "pad_token": "[PAD]"}))
    (folder / "preprocessor_config.json").write_text(json.dumps(PREPROCESSING))
    return folder


def _save(path, nodes, inputs, output, constants):
    made = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "small", inputs, [output], made)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10), str(path))
