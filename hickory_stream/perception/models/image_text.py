"""Image-text networks: a pair of graphs that bring pictures and words into one space of features.

The published files: a vision graph (`pixel_values` -> (1, D)), a text graph (`input_ids`, perhaps `attention_mask` ->
(1, D)), `tokenizer.json`, `preprocessor_config.json`, and perhaps `tokenizer_config.json` with the length and padding
of texts. Source: Radford et al., Learning transferable visual models from natural language supervision, ICML 2021.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ConfigError, ModelError
from hickory_stream.perception.models.image_text_pixels import pixels_of, read_preprocessing
from hickory_stream.perception.models.library import ModelEntry
from hickory_stream.perception.models.network import Network, NetworkConfig

# Where such networks are published each file has one of these names; what comes first is taken.
PUBLISHED = {
    "vision": ("vision_model.onnx", "onnx/vision_model.onnx"),
    "text": ("text_model.onnx", "onnx/text_model.onnx"),
    "tokenizer": ("tokenizer.json",),
    "preprocessor": ("preprocessor_config.json",),
    "tokenizer-config": ("tokenizer_config.json",),
}
OPTIONAL = ("tokenizer-config",)
# What stands before it is the projected feature, what comes later its stand-in where a graph has no projection.
_FEATURES = ("image_embeds", "text_embeds", "pooler_output")
_MOST_TOKENS = 77
_MOST_TOKENS_EVER = 4096


class ImageTextNetwork:
    """A loaded pair of graphs with its tokenizer, from the paths of its published files.

    Raises:
        ModelError: a graph is of another kind, or one of the other files cannot be read.
        ConfigError: the package `tokenizers` is not installed.
    """

    def __init__(
        self, vision: Network, text: Network, *, tokenizer: Path, preprocessor: Path, tokenizer_config: Path | None
    ) -> None:
        self._vision, self._text = vision, text
        self._preprocessing = read_preprocessing(preprocessor)
        self._vision_output = _feature_output(vision)
        self._text_output = _feature_output(text)
        names = {tensor.name for tensor in text.inputs}
        if "input_ids" not in names or not names <= {"input_ids", "attention_mask"}:
            raise text.mismatch("text", "input_ids, perhaps with attention_mask, as its inputs")
        self._tokenizer = _tokenizer(tokenizer)
        said = {} if tokenizer_config is None else _read_json(tokenizer_config)
        self._most_tokens = _most_tokens(text, said)
        self._has_mask = "attention_mask" in names
        self._tokenizer.enable_truncation(self._most_tokens)
        if self._has_mask and _fixed_length(text) is None:
            self._tokenizer.no_padding()
        else:
            # Such a graph was trained on texts that are filled up.
            self._tokenizer.enable_padding(length=self._most_tokens, **_padding_token(said, self._tokenizer, tokenizer))

    def of_image(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Return the (D,) feature, of unit norm, of a picture (H, W, 3); raises `ModelError`."""
        given = pixels_of(rgb, self._preprocessing)
        return _unit(self._vision.run(given)[self._vision_output], self._vision)

    def warm_up(self, rgb: NDArray[np.uint8]) -> None:
        """Run the vision graph once, and time it separately from later runs; raises `ModelError`."""
        self._vision.warm_up(pixels_of(rgb, self._preprocessing))

    def of_text(self, text: str) -> NDArray[np.float32]:
        """Return the (D,) feature, of unit norm, of a text; raises `ModelError`."""
        encoding = self._tokenizer.encode(text)
        given = {"input_ids": np.array([encoding.ids], np.int64)}
        if self._has_mask:
            given["attention_mask"] = np.array([encoding.attention_mask], np.int64)
        outputs = self._text.run_named(given, f"a text of {len(encoding.ids)} tokens")
        return _unit(outputs[self._text_output], self._text)

    def tokens_of(self, text: str) -> list[int]:
        """Return the token ids of a text for the text graph."""
        return list(self._tokenizer.encode(text).ids)


def open_image_text(entry: ModelEntry, vision: Network, config: NetworkConfig) -> ImageTextNetwork:
    """Return the network of an entry of the folder of models; raises as `ImageTextNetwork`."""
    folder = vision.path.parent
    roles = {one.role for one in entry.companions}
    return ImageTextNetwork(
        vision,
        Network(folder / entry.companion("text"), config),
        tokenizer=folder / entry.companion("tokenizer"),
        preprocessor=folder / entry.companion("preprocessor"),
        tokenizer_config=folder / entry.companion("tokenizer-config") if "tokenizer-config" in roles else None,
    )


def published_files(folder: Path) -> dict[str, Path]:
    """Return the files of a published pair by their roles; raises `ModelError` with all that are missing."""
    found = {
        role: next((folder / name for name in names if (folder / name).is_file()), None)
        for role, names in PUBLISHED.items()
    }
    missing = [" or ".join(PUBLISHED[role]) for role, path in found.items() if path is None and role not in OPTIONAL]
    if missing:
        raise ModelError(
            f"{folder} has no {', no '.join(missing)}; expected the files that such a network is published with: "
            "its two graphs, its tokenizer, its pre-processing"
        )
    return {role: path for role, path in found.items() if path is not None}


def _feature_output(network: Network) -> int:
    for name in _FEATURES:
        for i, tensor in enumerate(network.outputs):
            if tensor.name == name and len(tensor.shape) == 2:
                return i
    flat = [i for i, tensor in enumerate(network.outputs) if len(tensor.shape) == 2]
    if len(flat) != 1:
        raise network.mismatch("image-text", f"an output (1, D), named {', '.join(_FEATURES)} where there are several")
    return flat[0]


def _unit(feature: NDArray[Any], network: Network) -> NDArray[np.float32]:
    if feature.ndim != 2 or feature.shape[0] != 1:
        raise network.mismatch("image-text", f"a feature (1, D), got {feature.shape}")
    norm = float(np.linalg.norm(feature[0]))
    if not np.isfinite(norm) or norm == 0.0:
        raise ModelError(f"{network.path} gave a feature without a direction (NaN, infinity or zero)")
    return np.asarray(feature[0] / norm, dtype=np.float32)


def _tokenizer(path: Path) -> Any:
    try:
        from tokenizers import Tokenizer
    except ImportError as error:
        raise ConfigError(
            "an image-text network needs the package tokenizers: pip install 'hickory-stream[image-text]'"
        ) from error
    try:
        return Tokenizer.from_file(str(path))
    except Exception as error:  # it raises Exception itself
        raise ModelError(f"{path} is no tokenizer: {error}; take it from where the graphs come from") from error


def _fixed_length(text: Network) -> int | None:
    shape = next(tensor.shape for tensor in text.inputs if tensor.name == "input_ids")
    return shape[1] if len(shape) == 2 else None


def _most_tokens(text: Network, said: dict[str, Any]) -> int:
    # As the graph has it, else as the tokenizer's file says, else as CLIP.
    fixed, most = _fixed_length(text), said.get("model_max_length")
    if fixed is not None:
        return fixed
    # Files without a limit have a huge number there.
    return int(most) if isinstance(most, int | float) and 0 < most <= _MOST_TOKENS_EVER else _MOST_TOKENS


def _padding_token(said: dict[str, Any], tokenizer: Any, path: Path) -> dict[str, Any]:
    token = said.get("pad_token", tokenizer.padding["pad_token"] if tokenizer.padding else None)
    name = token.get("content") if isinstance(token, dict) else token
    number = tokenizer.token_to_id(name) if isinstance(name, str) else None
    if number is None:
        raise ModelError(
            f"{path} and tokenizer_config.json name no token to fill texts up with, which its text graph needs; add "
            'tokenizer_config.json with "pad_token" beside it'
        )
    return {"pad_id": number, "pad_token": name}


def _read_json(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ModelError(f"cannot read {path}: {error}") from error
    if not isinstance(data, dict):
        raise ModelError(f"{path} is no JSON object; take it from where the graphs come from")
    return data
