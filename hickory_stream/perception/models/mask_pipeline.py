"""The mask pipeline: from overlapping masks of any segmentation network to the instances of a frame.

Masks that are too small, structure, duplicates, or parts of another mask are rejected with a reason. A smaller mask
inside a larger one is an object if it protrudes from the surface around it, like a cup on a table, or lies flat on a
horizontal surface, like a magazine; a label on a box is a part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.bounds import extent_of
from hickory_stream.perception.masks import label_boxes, occluded_shares
from hickory_stream.perception.surface import Surface
from hickory_stream.records import RejectedMask

# Overlaps are counted with this stride in both directions: a mask worth keeping has hundreds of such pixels.
_STRIDE = 2
_RING_PX = 3
_LEAST_RING = 12
_WHOLE_SHARE = 0.7


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class InstanceMask:
    """A mask that may overlap others: `mask` (h, w) bool within `box_px` = (x0, y0, x1, y1), ends exclusive."""

    box_px: tuple[int, int, int, int]
    mask: NDArray[np.bool_]
    score: float = 1.0

    def __post_init__(self) -> None:
        x0, y0, x1, y1 = self.box_px
        freeze(self, "mask", np.bool_, (y1 - y0, x1 - x0))


# A mask that covers more of the image than this is the scene, not an object.
_MAX_SHARE = 0.6
# A mask with a larger share than this on floor, walls or ceiling is rejected.
_STRUCTURE_SHARE = 0.5
# Of two masks with a higher IoU the one with the better score is kept.
_DUPLICATE_IOU = 0.8
# A mask is inside a larger one if more than this share of it is.
_INSIDE_SHARE = 0.85
# A mask inside another one is an object of its own if it protrudes from the surface around it by this, plus three
# sigma of depth, or if it is flat on a horizontal surface and has at least this area.
_STANDS_OUT_M = 0.008
_FLAT_AREA_M2 = 0.008
# A mask of which smaller masks leave less than this share uncovered is a group of these masks.
_VISIBLE_SHARE = 0.25
# A small mask with more of its outline than this behind nearer surfaces is rejected.
_OCCLUDED_SHARE = 0.6


@dataclass(frozen=True, kw_only=True, slots=True)
class MaskConfig(Ranged):
    """Which masks of a network are rejected."""

    #: Smaller masks are rejected, in pixels of the frame.
    min_area_px: int = number(240, 0, 1_000_000, "px")
    #: Longer masks are rejected as structure.
    max_extent_m: float = number(4.0, 0.01, 1000, "m")


def compose(
    masks: Sequence[InstanceMask], surface: Surface, structure: NDArray[np.bool_], config: MaskConfig
) -> tuple[NDArray[np.int32], tuple[RejectedMask, ...]]:
    """Return the instances (H, W) int32, numbered from 1, of a frame's masks; and rejected masks with reasons."""
    areas = np.array([np.count_nonzero(mask.mask) for mask in masks], dtype=np.int64)
    reasons = [_why_unusable(mask, int(area), structure, config) for mask, area in zip(masks, areas, strict=True)]
    usable = [i for i, reason in enumerate(reasons) if reason is None]
    shared = _shared_pixels([masks[i] for i in usable])
    _reject_duplicates(masks, usable, shared, reasons)
    _reject_parts(masks, usable, shared, reasons, surface)
    order = sorted((i for i in usable if reasons[i] is None), key=lambda i: -areas[i])
    painted = _painted(masks, order, structure.shape)
    left = np.bincount(painted.ravel(), minlength=len(masks) + 1)[1:]
    for i in order:
        if left[i] < _VISIBLE_SHARE * areas[i]:
            reasons[i] = f"{1 - left[i] / areas[i]:.0%} of it is made up of smaller masks"
    kept = [i for i in order if reasons[i] is None]
    labels = painted if len(kept) == len(order) else _painted(masks, kept, structure.shape)
    for i, why in _why_no_objects(labels, surface, config):
        reasons[i - 1] = why
        labels[labels == i] = 0
    rejected = [(mask, why) for mask, why in zip(masks, reasons, strict=True) if why is not None]
    records = tuple(RejectedMask(box_px=mask.box_px, reason=why, mask=mask.mask) for mask, why in rejected)
    return _renumbered(labels, [i for i in kept if reasons[i] is None]), records


def _why_unusable(mask: InstanceMask, area: int, structure: NDArray[np.bool_], config: MaskConfig) -> str | None:
    x0, y0, x1, y1 = mask.box_px
    if area < max(config.min_area_px, 1):
        return f"{area} pixels, fewer than {max(config.min_area_px, 1)}"
    if area > _MAX_SHARE * structure.size:
        return f"{area / structure.size:.0%} of the image: the scene"
    on_structure = np.count_nonzero(structure[y0:y1, x0:x1] & mask.mask) / area
    if on_structure > _STRUCTURE_SHARE:
        return f"{on_structure:.0%} of it is floor, wall or ceiling"
    return None


def _reject_duplicates(
    masks: Sequence[InstanceMask],
    usable: Sequence[int],
    shared: NDArray[np.int64],
    reasons: list[str | None],
) -> None:
    # `shared` (N, N): pixels shared by `usable` masks, areas on its diagonal.
    areas = shared.diagonal()
    iou = shared / np.maximum(areas[:, None] + areas[None, :] - shared, 1)
    kept: list[int] = []
    for j in sorted(range(len(usable)), key=lambda j: (-masks[usable[j]].score, j)):
        most = float(iou[kept, j].max(initial=0.0))
        if most > _DUPLICATE_IOU:
            reasons[usable[j]] = f"a better mask covers the same (IoU {most:.2f})"
        else:
            kept.append(j)


def _reject_parts(
    masks: Sequence[InstanceMask],
    usable: Sequence[int],
    shared: NDArray[np.int64],
    reasons: list[str | None],
    surface: Surface,
) -> None:
    # Inside the smallest larger mask around them, without protruding from its surface.
    areas = np.maximum(shared.diagonal(), 1)
    kept: list[int] = []
    for j in sorted((j for j in range(len(usable)) if reasons[usable[j]] is None), key=lambda j: (-areas[j], j)):
        around = np.asarray(kept, dtype=np.int64)[shared[kept, j] > _INSIDE_SHARE * areas[j]]
        kept.append(j)
        if len(around):
            outer, share = masks[usable[around[-1]]], areas[j] / areas[around[-1]]
            if not _is_own_thing(masks[usable[j]], outer, share, surface):
                reasons[usable[kept.pop()]] = "part of a larger mask: nothing stands out"


def _is_own_thing(inner: InstanceMask, outer: InstanceMask, share: float, surface: Surface) -> bool:
    # `share` is the ratio of the two areas.
    factor, (height, width) = surface.factor, surface.depth_m.shape
    x0, y0, x1, y1 = inner.box_px
    rows = _working_lattice(y0, y1, factor, height)
    columns = _working_lattice(x0, x1, factor, width)
    window = (slice(rows.start, rows.stop), slice(columns.start, columns.stop))
    part, whole = (_sampled(mask, rows, columns, factor) for mask in (inner, outer))
    points, sigma_m = surface.points_world[window], surface.sigma_m[window]
    known = np.isfinite(points[..., 2])
    kernel = np.ones((2 * _RING_PX + 1, 2 * _RING_PX + 1), dtype=np.uint8)
    seen = part & known
    if not seen.any():
        return False
    ring = (cv2.dilate(part.astype(np.uint8), kernel) > 0) & ~part & whole & known
    if np.count_nonzero(ring) < _LEAST_RING:
        # The larger mask shows no surface around the inner one: it is a group of objects, unless both nearly coincide.
        return share < _WHOLE_SHARE
    normal, offset = _plane_of(points[ring].astype(np.float64))
    distance = np.abs(portable.matmul(points[seen], normal) - offset)
    # It suffices if 30 % of the mask protrude: the rim of a bowl, or the body of a cup behind its handle.
    if np.quantile(distance, 0.7) > _STANDS_OUT_M + 3 * float(np.median(sigma_m[seen])):
        return True
    return bool(abs(normal[2]) > 0.95 and _area_m2(points, seen, surface) > _FLAT_AREA_M2)


def _working_lattice(first: int, last: int, factor: int, size: int) -> range:
    # With a margin for the ring around a mask.
    return range(max(0, first // factor - _RING_PX), max(0, min(size, -(-last // factor) + _RING_PX)))


def _sampled(mask: InstanceMask, rows: range, columns: range, factor: int) -> NDArray[np.bool_]:
    x0, y0, x1, y1 = mask.box_px
    y, x = (np.asarray(places) * factor + factor // 2 for places in (rows, columns))
    out = np.zeros((len(rows), len(columns)), dtype=bool)
    inside_y, inside_x = (y >= y0) & (y < y1), (x >= x0) & (x < x1)
    out[np.ix_(inside_y, inside_x)] = mask.mask[np.ix_(y[inside_y] - y0, x[inside_x] - x0)]
    return out


def _plane_of(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    # Unit normal and offset through (N, 3) points, fitted again without the worst third.
    normal, offset = _least_squares_plane(points)
    distance = np.abs(portable.matmul(points, normal) - offset)
    return _least_squares_plane(points[distance <= np.quantile(distance, 0.67)])


def _least_squares_plane(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    middle = points.mean(axis=0)
    off = points - middle
    normal = portable.eigh(portable.matmul(off.T, off))[1][:, 0]
    return normal, portable.dot(middle, normal)


def _area_m2(points: NDArray[np.float32], seen: NDArray[np.bool_], surface: Surface) -> float:
    camera = surface.camera
    place = points[seen] - surface.world_from_camera[:3, 3]
    depth = portable.matmul(place, surface.world_from_camera[:3, 2])
    slant = np.abs(place[:, 2]) / np.maximum(np.linalg.norm(place, axis=1), 1e-6)
    return float((depth * depth / (camera.fx * camera.fy) / np.maximum(slant, 0.1)).sum())


def _shared_pixels(masks: Sequence[InstanceMask]) -> NDArray[np.int64]:
    # (N, N) the number of pixels shared by two masks, at a stride of `_STRIDE`; areas on the diagonal.
    if not masks:
        return np.zeros((0, 0), dtype=np.int64)
    boxes = np.array([m.box_px for m in masks], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum([m.mask.size for m in masks])]).astype(np.int64)
    pixels = np.concatenate([m.mask.ravel() for m in masks])
    return np.asarray(_count_shared(boxes, starts, pixels, _STRIDE))


@kernel
def _count_shared(boxes, starts, pixels, stride):
    count = len(boxes)
    shared = np.zeros((count, count), dtype=np.int64)
    for i in range(count):
        for j in range(i, count):
            x0, y0 = max(boxes[i, 0], boxes[j, 0]), max(boxes[i, 1], boxes[j, 1])
            x1, y1 = min(boxes[i, 2], boxes[j, 2]), min(boxes[i, 3], boxes[j, 3])
            total = 0
            width_i, width_j = boxes[i, 2] - boxes[i, 0], boxes[j, 2] - boxes[j, 0]
            for y in range(-(-y0 // stride) * stride, y1, stride):
                at_i = starts[i] + (y - boxes[i, 1]) * width_i - boxes[i, 0]
                at_j = starts[j] + (y - boxes[j, 1]) * width_j - boxes[j, 0]
                for x in range(-(-x0 // stride) * stride, x1, stride):
                    total += pixels[at_i + x] & pixels[at_j + x]
            shared[i, j] = shared[j, i] = total
    return shared


def _painted(masks: Sequence[InstanceMask], order: Sequence[int], shape: tuple[int, ...]) -> NDArray[np.int32]:
    # Labels i + 1, later masks over earlier ones.
    labels = np.zeros(shape, dtype=np.int32)
    for i in order:
        x0, y0, x1, y1 = masks[i].box_px
        labels[y0:y1, x0:x1][masks[i].mask] = i + 1
    return labels


def _why_no_objects(labels: NDArray[np.int32], surface: Surface, config: MaskConfig) -> list[tuple[int, str]]:
    factor, (height, width) = surface.factor, surface.depth_m.shape
    middle = factor // 2
    small = np.ascontiguousarray(labels[middle::factor, middle::factor][:height, :width])
    count = int(labels.max()) + 1
    occluded = occluded_shares(surface.depth_m, small, count)
    pixels = np.bincount(small.ravel(), minlength=count)
    boxes = label_boxes(small, count)
    small_area = 12 * config.min_area_px / (factor * factor)
    found = []
    for label in map(int, np.flatnonzero(pixels[1:]) + 1):
        why = _why_too_long(surface, small, label, boxes[label], config.max_extent_m)
        if occluded[label] > _OCCLUDED_SHARE and pixels[label] < small_area:
            why = f"{occluded[label]:.0%} of the outline is occluded by nearer surfaces"
        if why is not None:
            found.append((label, why))
    return found


def _why_too_long(
    surface: Surface, labels: NDArray[np.int32], label: int, box: NDArray[np.int64], max_extent_m: float
) -> str | None:
    # At working resolution.
    x0, y0, x1, y1 = box
    points = surface.points_world[y0:y1, x0:x1].reshape(-1, 3)
    part = points.take(np.flatnonzero((labels[y0:y1, x0:x1].ravel() == label) & np.isfinite(points[:, 2])), axis=0)
    extent = float(extent_of(part).max()) if len(part) else 0.0
    if extent > max_extent_m:  # the robust extent, without outliers, is slower: computed only if it matters
        extent = float(np.ptp(np.percentile(part, [3, 97], axis=0), axis=0).max())
    return f"{extent:.1f} m long: structure" if extent > max_extent_m else None


def _renumbered(labels: NDArray[np.int32], kept: Sequence[int]) -> NDArray[np.int32]:
    numbers = np.zeros(int(labels.max()) + 1, dtype=np.int32)
    visible = [i for i in sorted(kept) if i + 1 < len(numbers)]
    numbers[[i + 1 for i in visible]] = np.arange(1, len(visible) + 1)
    return numbers[labels]
