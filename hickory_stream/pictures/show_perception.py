"""Pictures of perception: masks, rejected masks with reasons, structure, features as colours."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.geometry.display import color_of_id, main_components
from hickory_stream.pictures.legend import legend_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.perception.masks import InstanceMask
    from hickory_stream.records import RejectedMask, Segmentation, SemanticImage

_PANEL_PX = 640
_CAPTION_PX = 26
_DARK, _LIGHT, _GREY = (24, 26, 32), (236, 236, 236), (128, 128, 132)
_STRUCTURE = (70, 110, 190)


def segmentation_picture(
    rgb: NDArray[np.uint8], segmentation: Segmentation, rejected: Sequence[RejectedMask], patches: NDArray[np.float32]
) -> NDArray[np.uint8]:
    """Return a picture (h, w, 3) of four panels: masks, rejected masks, depth's structure, patch features (h, w, D)."""
    count = int(segmentation.instances.max(initial=0))
    panels = [
        _panel(_with_instances(rgb, segmentation.instances), f"{count} masks"),
        _panel(_with_rejected(rgb, rejected), f"{len(rejected)} rejected"),
        _panel(_tinted(rgb, segmentation.structure, _STRUCTURE), "floor, walls, ceiling"),
        _panel(features_picture(patches, (rgb.shape[1], rgb.shape[0])), "features: three main components"),
    ]
    grid = np.vstack([np.hstack(panels[:2]), np.hstack(panels[2:])])
    return np.vstack([grid, _legend([f"{i + 1}: {r.reason}" for i, r in enumerate(rejected)], grid.shape[1])])


def masks_picture(rgb: NDArray[np.uint8], masks: Sequence[InstanceMask]) -> NDArray[np.uint8]:
    """Return a picture of masks that may overlap, with smaller masks above larger ones."""
    labels = np.zeros(rgb.shape[:2], dtype=np.int32)
    for i in sorted(range(len(masks)), key=lambda i: -int(masks[i].mask.sum())):
        x0, y0, x1, y1 = masks[i].box_px
        labels[y0:y1, x0:x1][masks[i].mask] = i + 1
    return _with_instances(rgb, labels)


def features_picture(patches: NDArray[np.float32], size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return features (h, w, D) as colours at `size` (width, height)."""
    if patches.size == 0:
        return np.zeros((size[1], size[0], 3), dtype=np.uint8)
    colors = main_components(patches).colors(patches)
    return np.asarray(cv2.resize(colors, size, interpolation=cv2.INTER_NEAREST), dtype=np.uint8)


def classes_picture(rgb: NDArray[np.uint8], semantics: SemanticImage) -> NDArray[np.uint8]:
    """Return a picture of classes, with a legend of those with the largest area."""
    picture = _with_instances(rgb, semantics.classes + 1, numbers=False)
    ids, areas = np.unique(semantics.classes[semantics.classes >= 0], return_counts=True)
    most = [int(i) for i in ids[np.argsort(-areas, kind="stable")][:12]]
    entries = [(semantics.labels[i], color_of_id(i + 1)) for i in most]
    return np.vstack([picture, legend_of(entries, picture.shape[1], ink=_LIGHT, ground=_DARK)])


def _with_instances(rgb: NDArray[np.uint8], labels: NDArray[np.int32], *, numbers: bool = True) -> NDArray[np.uint8]:
    colors = np.array([(0, 0, 0), *(color_of_id(i) for i in range(1, int(labels.max(initial=0)) + 1))], dtype=np.uint8)
    out = np.where((labels > 0)[..., None], (0.45 * rgb + 0.55 * colors[labels]).astype(np.uint8), rgb // 2 + 20)
    out[_outlines(labels)] = _LIGHT
    for i in range(1, len(colors) if numbers else 0):
        _number(out, labels == i, i)
    return out


def _with_rejected(rgb: NDArray[np.uint8], rejected: Sequence[RejectedMask]) -> NDArray[np.uint8]:
    out = (rgb // 2 + 20).astype(np.uint8)
    for i, item in enumerate(rejected):
        x0, y0, x1, y1 = item.box_px
        mask = np.zeros(rgb.shape[:2], dtype=bool)
        mask[y0:y1, x0:x1] = True if item.mask is None else item.mask
        out[mask] = (0.4 * out[mask] + 0.6 * np.array(color_of_id(i + 1))).astype(np.uint8)
        cv2.rectangle(out, (x0, y0), (max(x1 - 1, x0), max(y1 - 1, y0)), _GREY, 1)
        _number(out, mask, i + 1)
    return out


def _tinted(rgb: NDArray[np.uint8], mask: NDArray[np.bool_], color: tuple[int, int, int]) -> NDArray[np.uint8]:
    return np.where(mask[..., None], (0.4 * rgb + 0.6 * np.array(color)).astype(np.uint8), rgb // 2 + 20)


def _outlines(labels: NDArray[np.int32]) -> NDArray[np.bool_]:
    edges = np.zeros(labels.shape, dtype=bool)
    edges[:, 1:] |= labels[:, 1:] != labels[:, :-1]
    edges[1:] |= labels[1:] != labels[:-1]
    return edges & (labels > 0)


def _number(picture: NDArray[np.uint8], mask: NDArray[np.bool_], number: int) -> None:
    if not mask.any():
        return
    inside = cv2.distanceTransform(np.pad(mask.astype(np.uint8), 1), cv2.DIST_L2, 3)[1:-1, 1:-1]
    y, x = np.unravel_index(int(inside.argmax()), inside.shape)
    at = (int(x) - 5 * len(str(number)), int(y) + 6)
    for color, width in ((_DARK, 4), (_LIGHT, 1)):
        cv2.putText(picture, str(number), at, cv2.FONT_HERSHEY_SIMPLEX, 0.55, color, width, cv2.LINE_AA)


def _panel(picture: NDArray[np.uint8], caption: str) -> NDArray[np.uint8]:
    height = round(picture.shape[0] * _PANEL_PX / picture.shape[1])
    sized = cv2.resize(picture, (_PANEL_PX, max(height, 1)), interpolation=cv2.INTER_AREA)
    return np.vstack([_legend([caption], _PANEL_PX), sized])


def _legend(lines: Sequence[str], width: int) -> NDArray[np.uint8]:
    columns = max(1, width // 420) if len(lines) > 1 else 1
    rows = -(-len(lines) // columns)
    out = np.full((rows * _CAPTION_PX, width, 3), _DARK, dtype=np.uint8)
    for i, line in enumerate(lines):
        column, row = divmod(i, max(rows, 1))
        x, y = column * (width // columns) + 8, row * _CAPTION_PX + 18
        cv2.putText(out, line[:60], (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.45, _LIGHT, 1, cv2.LINE_AA)
    return out
