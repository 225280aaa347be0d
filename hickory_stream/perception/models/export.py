"""Export of the paper's networks from their official packages to ONNX; needs the extra `export`.

Each graph is compared with the prediction code of its package: our masks, features or classes by the graph against the
package's own, on a picture. A graph that differs is refused.
"""

import importlib.util
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ConfigError, HickoryError, ModelError
from hickory_stream.perception.models.dinov2 import DinoConfig, DinoExtractor
from hickory_stream.perception.models.fastsam import FastSam, FastSamConfig
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.models.preprocessing import built_in_picture, normalised
from hickory_stream.perception.models.semantic_graph import MASK_THRESHOLD, MIN_OVERLAP, GraphSemantics, PanopticConfig

OPSET = 18
LEAST_IOU = 0.99
MOST_FEATURE_ERROR = 1e-3
LEAST_CLASS_AGREEMENT = 0.99
_CPU = NetworkConfig(provider="cpu", warm_up=False)
_INSTALL = "install the extra: pip install 'hickory-stream[export]'"
_PACKAGES = {"fastsam": "ultralytics", "dinov2": "transformers", "oneformer": "transformers"}


@dataclass(frozen=True, kw_only=True, slots=True)
class Exported:
    """What the manifest says of a graph beside its file, and the result of the comparison."""

    input_px: tuple[int, int]
    labels: tuple[str, ...]
    compared: str


def require_exporter(kind: str) -> None:
    """Raise `ConfigError` if a kind of network cannot be exported here."""
    if kind not in _PACKAGES:
        raise ConfigError(f"only {', '.join(_PACKAGES)} can be exported; give a model of kind {kind} as ONNX")
    missing = [name for name in ("torch", "onnx", _PACKAGES[kind]) if importlib.util.find_spec(name) is None]
    if missing:
        raise ConfigError(f"{', '.join(missing)} missing, needed to export {kind}; {_INSTALL}")


def export_model(kind: str, weights: Path, file: Path, input_px: int) -> Exported:
    """Export weights, a file or a folder, to an ONNX file; `input_px` is the side of FastSAM's image.

    Raises:
        ConfigError: a package is missing.
        ModelError: the weights cannot be read, or the graph differs from the package's prediction.
    """
    require_exporter(kind)
    # A missing package is an error: ultralytics would install it. Its log goes to the standard output.
    os.environ.update(YOLO_AUTOINSTALL="false", YOLO_VERBOSE="false")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # tracing warns of each constant
            return EXPORTS[kind](weights, file, input_px)
    except HickoryError:
        raise
    except ImportError as error:
        raise ConfigError(f"{error}, needed to export {kind}; {_INSTALL}") from error
    except Exception as error:  # the exceptions of these packages have no common base
        raise ModelError(f"{weights} cannot be exported as {kind}: {error}") from error


def export_fastsam(weights: Path, file: Path, input_px: int) -> Exported:
    """Export FastSAM, or any YOLOv8-seg, with ultralytics; masks are compared with its own predictor's."""
    from ultralytics import YOLO, FastSAM

    kind = FastSAM if "fastsam" in weights.stem.lower() else YOLO
    with tempfile.TemporaryDirectory() as folder:
        # The package writes its graph beside the weights.
        model = kind(str(shutil.copy(weights, folder)))
        export_yolo(model, file, input_px)
    picture = built_in_picture()
    ours, theirs = fastsam_masks(file, picture), reference_fastsam_masks(model, picture, input_px)
    found = ious(ours, theirs)
    if len(ours) != len(theirs) or (theirs and found.mean() < LEAST_IOU):
        raise ModelError(
            f"the exported graph gives other masks than {weights}: {len(ours)} for {len(theirs)}, of mean IoU "
            f"{found.mean():.3f}, at least {LEAST_IOU}"
        )
    compared = (
        f"{len(theirs)} masks, IoU with the package's own {found.mean():.4f} on average" if theirs else "no masks"
    )
    return Exported(input_px=(input_px, input_px), labels=(), compared=compared)


def export_yolo(model: Any, file: Path, input_px: int) -> None:
    """Export a model of ultralytics for images of one size, their number in a run left open."""
    import onnx

    graph = onnx.load(model.export(format="onnx", imgsz=input_px, opset=OPSET, simplify=False, dynamic=True))
    for side in graph.graph.input[0].type.tensor_type.shape.dim[2:]:
        side.dim_value = input_px
    onnx.save(graph, str(file))


def fastsam_masks(file: Path, picture: NDArray[Any], config: FastSamConfig | None = None) -> list[NDArray[Any]]:
    """Return our masks of a picture at its size, those without a pixel left out as the package does."""
    masks, _ = FastSam(Network(file, _CPU), config or FastSamConfig(), warm_up=False).masks(picture)
    full = []
    for item in masks:
        x0, y0, x1, y1 = item.box_px
        mask = np.zeros(picture.shape[:2], dtype=bool)
        mask[y0:y1, x0:x1] = item.mask
        if mask.any():
            full.append(mask)
    return full


def reference_fastsam_masks(
    model: Any, picture: NDArray[Any], input_px: int, config: FastSamConfig | None = None
) -> list[NDArray[Any]]:
    """Return the masks of the package's own predictor; `rect=False` gives it the square image that the graph takes."""
    config = config or FastSamConfig()
    result = model.predict(
        picture[..., ::-1],
        imgsz=input_px,
        rect=False,
        conf=config.confidence,
        iou=config.nms_iou,
        max_det=config.max_masks,
        retina_masks=True,
        device="cpu",
        verbose=False,
    )[0]
    return [] if result.masks is None else [mask.numpy() > 0 for mask in result.masks.data]


def ious(ours: list[NDArray[Any]], theirs: list[NDArray[Any]]) -> NDArray[Any]:
    """Return the IoU of each of their masks with the one of ours that is most like it: scores may tie."""
    if not ours or not theirs:
        return np.full(max(len(ours), len(theirs)), 0.0)
    a, b = (np.stack([mask.ravel() for mask in masks]).astype(np.float32) for masks in (theirs, ours))
    shared = a @ b.T
    return np.asarray((shared / (a.sum(axis=1)[:, None] + b.sum(axis=1)[None, :] - shared)).max(axis=1))


def export_dinov2(weights: Path, file: Path, _input_px: int) -> Exported:
    """Export DINOv2 with transformers, its sizes left open; features are compared with the package's."""
    from transformers import AutoModel

    model = AutoModel.from_pretrained(weights, attn_implementation="eager").eval()
    error = export_dino_model(model, file, built_in_picture()[:224, :322])
    if error > MOST_FEATURE_ERROR:
        raise ModelError(f"the exported graph gives other features than {weights}: by {error:.2g}")
    return Exported(input_px=(0, 0), labels=(), compared=f"features differ by at most {error:.2g}")


def export_dino_model(model: Any, file: Path, picture: NDArray[Any]) -> float:
    """Export a DINOv2 of transformers, and return by how much our features of a picture differ from its own."""
    import torch

    class Tokens(torch.nn.Module):  # type: ignore[misc]  # torch has no types here
        def __init__(self) -> None:
            super().__init__()
            self.model = model

        def forward(self, pixel_values: Any) -> Any:
            return self.model(pixel_values).last_hidden_state

    patch = int(model.config.patch_size)
    example = torch.zeros((1, 3, 4 * patch, 6 * patch))
    _export(Tokens(), example, file, ["tokens"], {"tokens": {0: "images", 1: "tokens"}}, sizes_are_open=True)
    extractor = DinoExtractor(Network(file, _CPU), DinoConfig(patch_px=patch), warm_up=False)
    height, width = (n // patch * patch for n in picture.shape[:2])
    ours = extractor.extract(picture[:height, :width])
    with torch.no_grad():
        tokens = model(torch.from_numpy(normalised(picture[:height, :width]))).last_hidden_state[0].numpy()
    theirs = tokens[len(tokens) - ours.shape[0] * ours.shape[1] :].reshape(ours.shape)
    return float(np.abs(ours - theirs / np.linalg.norm(theirs, axis=-1, keepdims=True)).max())


def export_oneformer(weights: Path, file: Path, _input_px: int) -> Exported:
    """Export OneFormer with transformers, its task made part of the graph; classes are compared with the package's."""
    from transformers import CLIPTokenizer, OneFormerForUniversalSegmentation

    model = OneFormerForUniversalSegmentation.from_pretrained(weights, is_training=False).eval()
    # The package's processor also wants names of classes from a repository of its own; the task needs the tokens only.
    task = oneformer_task(CLIPTokenizer.from_pretrained(weights), model.config.task_seq_len)
    picture = built_in_picture()
    labels = tuple(model.config.id2label[i] for i in range(len(model.config.id2label)))
    agreement = export_oneformer_model(model, task, labels, file, picture)
    if agreement < LEAST_CLASS_AGREEMENT:
        raise ModelError(f"the exported graph gives other classes than {weights}: {agreement:.1%} of pixels agree")
    return Exported(input_px=ONEFORMER_PX, labels=labels, compared=f"classes of {agreement:.2%} of the pixels agree")


def oneformer_task(tokenizer: Any, length: int) -> Any:
    """Return (1, length) the tokens of the panoptic task, 0 behind its end, as the package's processor makes them."""
    tokens = tokenizer(
        "the task is panoptic", padding="max_length", max_length=length, truncation=True, return_tensors="pt"
    )
    return tokens["input_ids"] * tokens["attention_mask"]


# The backbone's windows make its graph one of a fixed size: 4:3, as most depth cameras.
ONEFORMER_PX = (640, 480)


def export_oneformer_model(
    model: Any, task: Any, labels: tuple[str, ...], file: Path, picture: NDArray[Any],
    size: tuple[int, int] = ONEFORMER_PX,
) -> float:  # fmt: skip
    """Export a OneFormer, and return the share of pixels of a picture whose class is that of the package's own code."""
    import cv2
    import torch
    from transformers.models.oneformer.image_processing_pil_oneformer import OneFormerImageProcessorPil

    class Queries(torch.nn.Module):  # type: ignore[misc]  # torch has no types here
        def __init__(self) -> None:
            super().__init__()
            self.model = model
            self.register_buffer("task", task)

        def forward(self, pixel_values: Any) -> Any:
            out = self.model(pixel_values=pixel_values, task_inputs=self.task)
            return out.class_queries_logits, out.masks_queries_logits

    _export(Queries(), torch.zeros((1, 3, size[1], size[0])), file, ["classes", "masks"], {}, sizes_are_open=False)
    config = PanopticConfig()
    ours = GraphSemantics(Network(file, _CPU), labels, short_px=size[1], panoptic=config, warm_up=False)
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    with torch.no_grad():
        outputs = model(pixel_values=torch.from_numpy(normalised(small)), task_inputs=task)
    theirs = reference_classes(OneFormerImageProcessorPil, outputs, (small.shape[0], small.shape[1]), config)
    return float((ours.classify(small).classes == theirs).mean())


def reference_classes(processor: Any, outputs: Any, size: tuple[int, int], config: PanopticConfig) -> NDArray[Any]:
    """Return (H, W) classes by the package's panoptic post-processing, -1 where it names no segment."""
    result = processor.post_process_panoptic_segmentation(
        None,
        outputs,
        threshold=config.threshold,
        mask_threshold=MASK_THRESHOLD,
        overlap_mask_area_threshold=MIN_OVERLAP,
        label_ids_to_fuse=set(),
        target_sizes=[size],
    )[0]
    classes = np.full(size, -1, dtype=np.int32)
    segments = result["segmentation"].numpy()
    for segment in result["segments_info"]:
        classes[segments == segment["id"]] = segment["label_id"]
    return classes


def _export(
    module: Any, example: Any, file: Path, outputs: list[str], axes: dict[str, dict[int, str]], *, sizes_are_open: bool
) -> None:
    import torch

    if sizes_are_open:
        axes = {"image": {0: "images", 2: "height", 3: "width"}, **axes}
    try:
        with torch.no_grad():
            torch.onnx.export(
                module.eval(), (example,), str(file), input_names=["image"], output_names=outputs, dynamic_axes=axes,
                opset_version=OPSET, dynamo=False,
            )  # fmt: skip
    except torch.onnx.errors.OnnxExporterError as error:
        raise ModelError(f"torch cannot export this network: {error}") from error
    _use_single_precision(file)


def _use_single_precision(file: Path) -> None:
    import onnx

    model = onnx.load(str(file))
    for i, node in reversed(list(enumerate(model.graph.node))):
        if node.op_type == "GridSample":
            cast = f"{node.output[0]}_places"
            model.graph.node.insert(
                i, onnx.helper.make_node("Cast", [node.input[1]], [cast], to=onnx.TensorProto.FLOAT)
            )
            node.input[1] = cast
    onnx.save(model, str(file))


EXPORTS: dict[str, Callable[[Path, Path, int], Exported]] = {
    "fastsam": export_fastsam,
    "dinov2": export_dinov2,
    "oneformer": export_oneformer,
}
