"""The SAM family: masks of everything by a pair of graphs, as the original's automatic mask generator makes them.

The encoder takes an image; the decoder takes its outputs and point prompts, and gives low-resolution mask logits with
predicted IoUs. Tensors have the names of the usual exporters: `export_onnx_model` of segment-anything and MobileSAM,
samexporter for SAM, MobileSAM and SAM 2. Sources: Kirillov et al., Segment Anything, ICCV 2023; Ravi et al., SAM 2:
Segment Anything in Images and Videos, ICLR 2025.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.errors import ModelError
from hickory_stream.perception.masks import InstanceMask
from hickory_stream.perception.models.library import ModelEntry
from hickory_stream.perception.models.network import Network, NetworkConfig
from hickory_stream.perception.models.preprocessing import normalised
from hickory_stream.perception.models.yolo_masks import Taps, suppressed, taps_along

# Of the original: prompts in one run, the logits' shift for the stability score, and the box IoU of duplicates.
_POINTS_PER_RUN = 64
_STABILITY_OFFSET = 1.0
_NMS_IOU = 0.7
_MAX_MASKS = 1000
_PROMPTS = ("point_coords", "point_labels", "mask_input", "has_mask_input", "orig_im_size")
# Side of a low-resolution mask, by which the image's side is four times as large.
_DEFAULT_LOW_PX = 256
_DTYPES = {"float16": np.float16, "int64": np.int64, "int32": np.int32}


@dataclass(frozen=True, kw_only=True, slots=True)
class SamConfig(Ranged):
    """How masks are generated; the defaults are the original's."""

    #: Name of the pair of networks in the folder of models.
    model: str = "sam"
    #: Point prompts along each side of the image; each gives up to three masks.
    points_per_side: int = number(32, 1, 128, "points")
    #: Minimum IoU that the network predicts for a mask; SAM 2's own default is 0.8.
    predicted_iou: float = number(0.88, 0, 1, "IoU")
    #: Minimum IoU of a mask's areas at thresholds one logit above and below.
    stability: float = number(0.95, 0, 1, "IoU")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Place:
    # How an image (`width`, `height`) lies in the network's, and how low-resolution masks return to it.
    width: int
    height: int
    inner_width: int
    inner_height: int
    rows: Taps
    columns: Taps


def open_sam(entry: ModelEntry, encoder: Network, network: NetworkConfig, config: SamConfig) -> "Sam":
    """Return the pair of an entry of the folder of models; raises as `Sam`."""
    decoder = Network(encoder.path.parent / entry.companion("decoder"), network)
    return Sam(encoder, decoder, config, warm_up=network.warm_up)


def pair_of(folder: Path) -> dict[str, Path]:
    """Return encoder and decoder among the ONNX files of a folder, by their names; raises `ModelError`."""
    files = sorted(folder.glob("*.onnx"))
    decoders = [file for file in files if "decoder" in file.name.lower()]
    encoders = [file for file in files if "encoder" in file.name.lower() and file not in decoders]
    if len(encoders) != 1 or len(decoders) != 1:
        found = ", ".join(file.name for file in files) or "none"
        raise ModelError(
            f"{folder} needs one *encoder*.onnx and one *decoder*.onnx of the SAM family; its ONNX files: {found}"
        )
    return {"encoder": encoders[0], "decoder": decoders[0]}


class Sam:
    """A pair of networks; from an image to masks that may overlap. Raises `ModelError` for graphs of another kind."""

    def __init__(self, encoder: Network, decoder: Network, config: SamConfig, *, warm_up: bool = True) -> None:
        self._encoder, self._decoder, self._config = encoder, decoder, config
        given = {tensor.name: tensor for tensor in decoder.inputs}
        if not {"point_coords", "point_labels"} <= set(given):
            raise decoder.mismatch("SAM decoder", "point_coords (1, N, 2) and point_labels (1, N) among its inputs")
        self._prompts = {name: given[name] for name in _PROMPTS if name in given}
        self._embeddings = _sources(encoder, decoder, [name for name in given if name not in _PROMPTS])
        self._can_batch = given["point_coords"].shape[0] is None
        # Only SAM 1 is told the size of the image: it pads, where SAM 2 stretches. Its decoder wants a padding point.
        self._pads = "orig_im_size" in given
        mask_shape = given["mask_input"].shape if "mask_input" in given else ()
        self._low_px = (mask_shape[-1] if mask_shape else None) or _DEFAULT_LOW_PX
        names = [tensor.name for tensor in decoder.outputs]
        if "iou_predictions" not in names or not {"low_res_masks", "masks"} & set(names):
            raise decoder.mismatch("SAM decoder", "iou_predictions and masks or low_res_masks among its outputs")
        self._ious = names.index("iou_predictions")
        self._masks = names.index("low_res_masks" if "low_res_masks" in names else "masks")
        if warm_up:
            self._encoder.warm_up(self._image(np.zeros((8, 8, 3), dtype=np.uint8), self._place(8, 8)))

    def masks(self, rgb: NDArray[np.uint8]) -> tuple[list[InstanceMask], int]:
        """Return the masks of an image (H, W, 3), best first, and the number of non-finite predictions."""
        place = self._place(rgb.shape[1], rgb.shape[0])
        image = self._image(rgb, place)
        outputs = self._encoder.run_named({self._encoder.inputs[0].name: image}, f"an image of {rgb.shape[1::-1]}")
        embeddings = {name: outputs[i] for name, i in self._embeddings.items()}
        found: list[tuple[float, tuple[int, int, int, int], NDArray[np.uint8]]] = []
        num_not_finite = 0
        for points in self._grid(place):
            masks, ious = self._decoded(points, embeddings, place)
            is_finite = np.isfinite(ious) & np.isfinite(masks.sum(axis=(1, 2), dtype=np.float64))
            num_not_finite += int(np.count_nonzero(~is_finite))
            for i in np.flatnonzero(is_finite & (ious > self._config.predicted_iou)):
                box, mask = self._stable(masks[i], place)
                if mask is not None:
                    # Bits, since a thousand masks may cover the image.
                    found.append((float(ious[i]), box, np.packbits(mask)))
        return _without_duplicates(found), num_not_finite

    def _place(self, width: int, height: int) -> _Place:
        low, side, longer = self._low_px, 4 * self._low_px, max(width, height)
        inner = [max(1, int(n * side / longer + 0.5)) if self._pads else side for n in (width, height)]
        # SAM 1 enlarges masks to the network's image first, cuts its padding off, and resizes them again.
        factor = 4 if self._pads else 1
        columns, rows = (
            taps_along(n, size=low, factor=factor, first=0, count=count * factor // 4)
            for n, count in zip((width, height), inner, strict=True)
        )
        return _Place(
            width=width, height=height, inner_width=inner[0], inner_height=inner[1], rows=rows, columns=columns
        )

    def _image(self, rgb: NDArray[np.uint8], place: _Place) -> NDArray[Any]:
        from PIL import Image

        # As the originals do: bilinear, with wider filters where an image becomes smaller.
        size = (place.inner_width, place.inner_height)
        inner = np.asarray(Image.fromarray(rgb).resize(size, Image.Resampling.BILINEAR))
        kind = np.float16 if self._encoder.inputs[0].dtype == "float16" else np.float32
        if len(self._encoder.inputs[0].shape) == 3:
            # Exported with its pre-processing: colour (H, W, 3) from 0 to 255.
            return inner.astype(kind)
        side = 4 * self._low_px
        image = np.zeros((1, 3, side, side), dtype=kind)
        image[:, :, : place.inner_height, : place.inner_width] = normalised(inner)
        return image

    def _grid(self, place: _Place) -> Iterator[NDArray[np.float32]]:
        # Batches (N, 2) of prompts in the network's image.
        num = self._config.points_per_side
        along = (np.arange(num) + 0.5) / num
        x, y = np.meshgrid(along * place.inner_width, along * place.inner_height)
        points = np.stack([x, y], axis=-1).reshape(-1, 2).astype(np.float32)
        step = _POINTS_PER_RUN if self._can_batch else 1
        return (points[i : i + step] for i in range(0, len(points), step))

    def _decoded(
        self, points: NDArray[np.float32], embeddings: dict[str, NDArray[Any]], place: _Place
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        # Mask logits (M, low, low) and predicted IoUs (M,) of prompts (N, 2).
        num, low = len(points), self._low_px
        values: dict[str, NDArray[Any]] = {
            "point_coords": points[:, None],
            "point_labels": np.ones((num, 1)),
            "mask_input": np.zeros((num, 1, low, low)),
            # One for all prompts: samexporter's decoder of SAM 2 would spread one of each along the width of masks.
            "has_mask_input": np.zeros(1),
            "orig_im_size": np.array([place.height, place.width]),
        }
        if self._pads:
            values["point_coords"] = np.concatenate([points[:, None], np.zeros((num, 1, 2))], axis=1)
            values["point_labels"] = np.tile([1.0, -1.0], (num, 1))
        if "mask_input" in self._prompts and self._prompts["mask_input"].shape[0] == 1:
            values["mask_input"] = values["mask_input"][:1]
        given = {
            name: values[name].astype(_DTYPES.get(tensor.dtype, np.float32)) for name, tensor in self._prompts.items()
        }
        outputs = self._decoder.run_named({**embeddings, **given}, f"{num} points")
        masks, ious = outputs[self._masks], outputs[self._ious]
        if masks.ndim != 4 or ious.shape != masks.shape[:2] or masks.shape[2:] != (low, low):
            expected = f"masks (N, K, {low}, {low}) and IoUs (N, K) from it, got {masks.shape} and {ious.shape}"
            raise self._decoder.mismatch("SAM decoder", expected)
        # The first of four masks is for several prompts: the original leaves it out.
        skipped = 1 if ious.shape[1] == 4 else 0
        return masks[:, skipped:].reshape(-1, low, low), ious[:, skipped:].ravel()

    def _stable(
        self, logits: NDArray[np.float32], place: _Place
    ) -> tuple[tuple[int, int, int, int], NDArray[np.bool_] | None]:
        # The box and the mask of logits (low, low) within it; no mask if it is empty or not stable.
        mask = np.zeros((place.height, place.width), dtype=np.bool_)
        high, low, *box = _enlarge(
            logits,
            place.rows.at,
            place.rows.weights,
            place.columns.at,
            place.columns.weights,
            np.float32(_STABILITY_OFFSET),
            mask,
        )
        x0, y0, x1, y1 = box
        if x1 <= x0 or high < self._config.stability * low:
            return (0, 0, 0, 0), None
        return (x0, y0, x1, y1), mask[y0:y1, x0:x1]


def _sources(encoder: Network, decoder: Network, wanted: list[str]) -> dict[str, int]:
    # The encoder's output for each embedding that the decoder takes: by name, or the only one.
    names = [tensor.name for tensor in encoder.outputs]
    if len(wanted) == len(names) == 1:
        return {wanted[0]: 0}
    missing = [name for name in wanted if name not in names]
    if missing or not wanted:
        raise encoder.mismatch(
            "SAM encoder", f"the outputs {', '.join(missing or ['image_embeddings'])} for {decoder.path}"
        )
    return {name: names.index(name) for name in wanted}


def _without_duplicates(
    found: list[tuple[float, tuple[int, int, int, int], NDArray[np.uint8]]],
) -> list[InstanceMask]:
    # Box NMS as the original's, with boxes whose last pixel is their border.
    order = sorted(range(len(found)), key=lambda i: (-found[i][0], i))
    boxes = np.array([found[i][1] for i in order], dtype=np.float32).reshape(-1, 4)
    boxes[:, 2:] -= 1
    masks = []
    for kept in suppressed(boxes, _NMS_IOU, _MAX_MASKS):
        score, box, bits = found[order[kept]]
        shape = (box[3] - box[1], box[2] - box[0])
        mask = np.unpackbits(bits, count=shape[0] * shape[1]).reshape(shape).astype(np.bool_)
        masks.append(InstanceMask(box_px=box, mask=mask, score=score))
    return masks


@kernel
def _enlarge(values, rows, row_weights, columns, column_weights, offset, out):
    # Whether values (h, w), interpolated from three rows and three columns per pixel, are above 0; how many are above
    # and not below the offset; and the box of those above 0. `out` is False before.
    height, width = values.shape
    top, bottom, left, right = height, -1, width, -1
    for y in range(height):
        for x in range(width):
            if values[y, x] > -offset:
                top, bottom, left, right = min(top, y), y, min(left, x), max(right, x)
    first = np.searchsorted(columns, left - 2)
    last = np.searchsorted(columns, right, side="right")
    line = np.zeros(max(width, 3), dtype=np.float32)
    high = low = 0
    x0, y0, x1, y1 = len(columns), len(rows), 0, 0
    # An interpolated value is not above those that it comes from: what lies around the box stays False.
    for y in range(len(rows)):
        if rows[y] + 2 < top or rows[y] > bottom:
            continue
        for x in range(max(0, left - 2), min(width, right + 3)):
            line[x] = 0
            for k in range(min(3, height)):
                line[x] += row_weights[y, k] * values[rows[y] + k, x]
        for x in range(first, last):
            i = columns[x]
            total = column_weights[x, 0] * line[i]
            total += column_weights[x, 1] * line[i + 1] + column_weights[x, 2] * line[i + 2]
            if total > -offset:
                low += 1
                high += total > offset
                if total > 0:
                    out[y, x] = True
                    x0, y0, x1, y1 = min(x0, x), min(y0, y), max(x1, x + 1), y + 1
    return high, low, x0, y0, x1, y1
