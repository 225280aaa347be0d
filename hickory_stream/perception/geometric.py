"""The segmenter without weights: class-agnostic instances from depth and colour, on a CPU.

Structure is taken away, the rest falls into fragments at depth edges, concave creases and supporting planes, and
fragments that are one thing are joined again. Works at a reduced size; labels come back at the size of the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import cv2
import numpy as np

from hickory_stream.geometry.voxels import contains, keys_of_points
from hickory_stream.perception.fragments import FragmentConfig, concave_creases, fragments_of, support_labels
from hickory_stream.perception.holes import HoleConfig, filled
from hickory_stream.perception.join import JoinConfig, join_fragments
from hickory_stream.perception.pieces import label_boxes
from hickory_stream.perception.structure import (
    StructureConfig,
    floor_height_m,
    horizontal_planes,
    pixel_areas_m2,
    structure_mask,
)
from hickory_stream.perception.surface import Surface, SurfaceConfig, surface_of
from hickory_stream.records import RejectedMask, Segmentation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Frame, ObservedSpace


@dataclass(frozen=True, kw_only=True, slots=True)
class GeometricConfig:
    """The geometric segmenter's parts, and what a mask must be.

    Attributes:
        min_area_px: masks with fewer working pixels are rejected.
        max_extent_m: masks of longer things are rejected as structure.
        hidden_share: a small mask with more of its outline than this behind something nearer is rejected.
        support_area_m2: the least visible area of a supporting plane.
    """

    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    structure: StructureConfig = field(default_factory=StructureConfig)
    fragments: FragmentConfig = field(default_factory=FragmentConfig)
    join: JoinConfig = field(default_factory=JoinConfig)
    holes: HoleConfig = field(default_factory=HoleConfig)
    min_area_px: int = 60
    max_extent_m: float = 3.0
    hidden_share: float = 0.6
    support_area_m2: float = 0.03


class GeometricSegmenter:
    """Segments frames by geometry and colour; it has no state but its configuration."""

    def __init__(self, config: GeometricConfig) -> None:
        self._config = config

    def prepare(self, frame: Frame) -> Surface:
        """Return the surface of a frame: what takes longest of it, and needs no map."""
        return surface_of(frame, self._config.surface)

    def segment(self, frame: Frame, prior: ObservedSpace | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prior` is the space as the map knows it."""
        config = self._config
        surface = prepared if isinstance(prepared, Surface) else self.prepare(frame)
        areas_m2 = pixel_areas_m2(surface)
        planes = horizontal_planes(surface, areas_m2, min_area_m2=config.support_area_m2)
        known_floor = prior.floor_z_m if prior is not None else None
        floor_z_m = floor_height_m(surface, planes, known_floor, config.structure)
        structure = structure_mask(surface, areas_m2, floor_z_m, config.structure) | _known_structure(surface, prior)
        heights = np.array([p.z_m for p in planes if floor_z_m is None or p.z_m > floor_z_m + 0.06])
        supports = support_labels(surface, heights, min_pixels=config.min_area_px)
        creases = concave_creases(surface, config.fragments)
        labels = fragments_of(surface, structure, supports, creases, config.fragments)
        labels = join_fragments(surface, labels, supports, areas_m2, structure, floor_z_m, config.join)
        labels, rejected = _usable(surface, labels, config)
        labels = filled(labels, np.isfinite(surface.depth_m), config.holes)
        size = (frame.camera.width, frame.camera.height)
        return Segmentation(
            instances=_enlarged(labels, surface.factor, size),
            structure=_enlarged(structure.astype(np.uint8), surface.factor, size) > 0,
            floor_z_m=floor_z_m,
            rejected=rejected,
        )


def _known_structure(surface: Surface, prior: ObservedSpace | None) -> NDArray[np.bool_]:
    """Return (h, w) the pixels in voxels that the map knows as structure: a wall seen in part is still a wall."""
    mask = np.zeros(surface.depth_m.shape, dtype=bool)
    if prior is None or len(prior.structure) == 0:
        return mask
    valid = np.isfinite(surface.depth_m)
    mask[valid] = contains(prior.structure, keys_of_points(surface.points_world[valid], prior.voxel_m))
    return mask


def _usable(
    surface: Surface, labels: NDArray[np.int32], config: GeometricConfig
) -> tuple[NDArray[np.int32], tuple[RejectedMask, ...]]:
    """Return the labels of the masks worth lifting, renumbered, and the others with their reasons."""
    count = int(labels.max()) + 1
    pixels = np.bincount(labels.ravel(), minlength=count)
    hidden = _hidden_shares(surface.depth_m, labels, count)
    keep = np.zeros(count, dtype=np.int32)
    rejected: list[RejectedMask] = []
    kept = 0
    boxes = label_boxes(labels, count)
    for i in range(1, count):
        reason = _why_not(surface, labels, i, int(pixels[i]), float(hidden[i]), boxes[i], config)
        if reason is None:
            kept += 1
            keep[i] = kept
        else:
            x0, y0, x1, y1 = (int(v) * surface.factor for v in boxes[i])
            rejected.append(RejectedMask(box_px=(x0, y0, x1, y1), reason=reason))
    return keep[labels], tuple(rejected)


def _why_not(
    surface: Surface,
    labels: NDArray[np.int32],
    label: int,
    pixels: int,
    hidden: float,
    box: NDArray[np.int64],
    config: GeometricConfig,
) -> str | None:
    if pixels < config.min_area_px:
        return f"{pixels} working pixels, fewer than {config.min_area_px}"
    if hidden > config.hidden_share and pixels < 12 * config.min_area_px:
        return f"{hidden:.0%} of the outline is hidden by nearer things"
    x0, y0, x1, y1 = box
    part = surface.points_world[y0:y1, x0:x1][labels[y0:y1, x0:x1] == label]
    extent = float(np.ptp(part, axis=0).max())
    if extent > config.max_extent_m:  # only then is it worth the time to leave strays out
        extent = float(np.ptp(np.percentile(part, [3, 97], axis=0), axis=0).max())
    if extent > config.max_extent_m:
        return f"{extent:.1f} m long: structure"
    return None


def _hidden_shares(depth_m: NDArray[np.float32], labels: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Return the share of each label's outline where the neighbour is nearer: where something hides the rest of it."""
    outline, hidden = np.zeros(count), np.zeros(count)
    height, width = labels.shape
    for dy, dx in ((0, 1), (1, 0)):
        a = (slice(0, height - dy), slice(0, width - dx))
        b = (slice(dy, height), slice(dx, width))
        for here, there in ((a, b), (b, a)):
            edge = (labels[here] != labels[there]) & (labels[here] > 0)
            names = labels[here][edge]
            outline += np.bincount(names, minlength=count)
            nearer = depth_m[there][edge] < depth_m[here][edge] * 0.97 - 0.01
            hidden += np.bincount(names, weights=nearer, minlength=count)
    return hidden / np.maximum(outline, 1)


def _enlarged(labels: NDArray[np.int32] | NDArray[np.uint8], factor: int, size: tuple[int, int]) -> NDArray[np.int32]:
    """Return labels at the size of the frame (width, height); what the reduction cut off has label 0."""
    if factor == 1:
        return labels.astype(np.int32)
    large = np.zeros((size[1], size[0]), dtype=np.int32)
    big = cv2.resize(
        labels.astype(np.int32).view(np.float32),  # nearest neighbour copies bits, and cv2 resizes no int32
        (labels.shape[1] * factor, labels.shape[0] * factor),
        interpolation=cv2.INTER_NEAREST,
    ).view(np.int32)
    large[: big.shape[0], : big.shape[1]] = big
    return large
