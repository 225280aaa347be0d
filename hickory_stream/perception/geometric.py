"""The segmenter without networks: class-agnostic instances from depth and colour, on a CPU.

Structure is taken away, the rest falls into fragments at depth edges, concave creases and supporting planes, and
fragments that are one thing are joined again. Works at a reduced size; labels come back at the size of the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.fragments import FragmentConfig, concave_creases, fragments_of, support_labels
from hickory_stream.perception.join import JoinConfig, join_fragments
from hickory_stream.perception.masks import enlarged, enlarged_mask, hidden_shares, why_no_object
from hickory_stream.perception.pieces import label_boxes
from hickory_stream.perception.scenery import Scenery, scenery_of
from hickory_stream.perception.shades import ShadeConfig, divided_by_color
from hickory_stream.perception.structure import StructureConfig
from hickory_stream.perception.surface import Surface, SurfaceConfig, surface_of
from hickory_stream.perception.trees import Trees, embedded_trees
from hickory_stream.ranges import Ranged, number
from hickory_stream.records import RejectedMask, Segmentation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Frame, ObservedSpace


@dataclass(frozen=True, kw_only=True, slots=True)
class GeometricConfig(Ranged):
    """The geometric segmenter's parts, and what a mask must be.

    Attributes:
        min_area_px: masks with fewer working pixels are rejected ...
        min_side_sigmas: ... and so are those that a square covers whose side is so many sigmas of depth: what they show
            cannot be told from noise.
        hidden_area_px: a mask with fewer working pixels ...
        hidden_share: ... and more of its outline than this behind something nearer is rejected.
        max_extent_m: masks of longer things are rejected as structure.
        support_area_m2: the least visible area of a supporting plane ...
        support_area_px: ... and the fewest working pixels of a piece of it.
    """

    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    structure: StructureConfig = field(default_factory=StructureConfig)
    fragments: FragmentConfig = field(default_factory=FragmentConfig)
    shades: ShadeConfig = field(default_factory=ShadeConfig)
    join: JoinConfig = field(default_factory=JoinConfig)
    min_area_px: int = number(16, 1, 1_000_000, "px")
    min_side_sigmas: float = number(2.5, 0, 100, "sigmas")
    hidden_area_px: int = number(720, 0, 1_000_000, "px")
    hidden_share: float = number(0.6, 0, 1, "share")
    max_extent_m: float = number(4.0, 0.01, 1000, "m")
    support_area_m2: float = number(0.03, 0, 1000, "m2")
    support_area_px: int = number(60, 1, 1_000_000, "px")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fragments:
    """A frame in pieces at working resolution (h, w): `labels` 1..n, and the supporting plane of each pixel or 0."""

    surface: Surface
    scenery: Scenery
    supports: NDArray[np.int32]
    labels: NDArray[np.int32]


class GeometricSegmenter:
    """Segments frames by geometry and colour; it has no state but its configuration.

    `trees` tell what is one thing; None: those of the package.
    """

    def __init__(self, config: GeometricConfig, trees: Trees | None = None) -> None:
        self._config = config
        self._trees = trees or embedded_trees(config.join.forest)

    def prepare(self, frame: Frame) -> Surface:
        """Return the surface of a frame: what takes longest of it, and needs no map."""
        return surface_of(frame, self._config.surface)

    def segment(self, frame: Frame, prior: ObservedSpace | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prior` is the space as the map knows it."""
        pieces = self.fragments(frame, prior, prepared)
        join = self._config.join
        labels = join_fragments(pieces.surface, pieces.labels, pieces.supports, pieces.scenery, self._trees, join)
        return self.segmentation(frame, pieces, labels)

    def segmentation(self, frame: Frame, pieces: Fragments, labels: NDArray[np.int32]) -> Segmentation:
        """Return what is said of a frame whose fragments were joined into the masks `labels` (h, w), 0 = none."""
        labels, rejected = _usable(pieces.surface, labels, self._config)
        size, factor = (frame.camera.width, frame.camera.height), pieces.surface.factor
        return Segmentation(
            instances=enlarged(labels, factor, size),
            structure=enlarged_mask(pieces.scenery.structure, factor, size),
            structure_shown=enlarged_mask(pieces.scenery.shown, factor, size),
            floor_z_m=pieces.scenery.floor_z_m,
            rejected=rejected,
        )

    def fragments(self, frame: Frame, prior: ObservedSpace | None = None, prepared: object = None) -> Fragments:
        """Return the pieces that a frame falls into, before any are joined."""
        surface = prepared if isinstance(prepared, Surface) else self.prepare(frame)
        return self.divided(surface, self.scenery(surface, prior))

    def scenery(self, surface: Surface, prior: ObservedSpace | None) -> Scenery:
        """Return the room in a frame; `prior` is the space as the map knows it."""
        return scenery_of(surface, prior, self._config.structure, self._config.support_area_m2)

    def divided(self, surface: Surface, scenery: Scenery) -> Fragments:
        """Return the pieces that a surface falls into where it is not structure."""
        config, floor_z_m = self._config, scenery.floor_z_m
        heights = np.array([p.z_m for p in scenery.planes if floor_z_m is None or p.z_m > floor_z_m + 0.06])
        supports = support_labels(surface, heights, min_pixels=config.support_area_px)
        creases = concave_creases(surface, scenery.structure, config.fragments)
        labels = fragments_of(surface, scenery.structure, supports, creases, config.fragments)
        boxes = label_boxes(labels, int(labels.max()) + 1)
        labels = divided_by_color(labels, boxes, surface.lab, config.shades)
        return Fragments(surface=surface, scenery=scenery, supports=supports, labels=labels)


def _usable(
    surface: Surface, labels: NDArray[np.int32], config: GeometricConfig
) -> tuple[NDArray[np.int32], tuple[RejectedMask, ...]]:
    """Return the labels of the masks worth lifting, renumbered, and the others with their reasons."""
    count = int(labels.max()) + 1
    pixels = np.bincount(labels.ravel(), minlength=count)
    hidden = hidden_shares(surface.depth_m, labels, count)
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
            u0, v0, u1, v1 = boxes[i]
            mask = enlarged_mask(labels[v0:v1, u0:u1] == i, surface.factor, (x1 - x0, y1 - y0))
            rejected.append(RejectedMask(box_px=(x0, y0, x1, y1), reason=reason, mask=mask))
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
    side_m, sigma_m = _side_and_sigma_m(surface, labels, label, pixels, box)
    if side_m < config.min_side_sigmas * sigma_m:
        return f"{100 * side_m:.1f} cm in a square, less than {config.min_side_sigmas:g} sigmas of depth"
    if hidden > config.hidden_share and pixels < config.hidden_area_px:
        return f"{hidden:.0%} of the outline is hidden by nearer things"
    return why_no_object(surface, labels, label, box, config.max_extent_m)


def _side_and_sigma_m(
    surface: Surface, labels: NDArray[np.int32], label: int, pixels: int, box: NDArray[np.int64]
) -> tuple[float, float]:
    """Return the side of a square that covers as much of the view as a mask does, and the sigma of depth, there."""
    x0, y0, x1, y1 = box
    inside = labels[y0:y1, x0:x1] == label
    # Every pixel of a fragment has a depth.
    depth_m = float(np.median(surface.depth_m[y0:y1, x0:x1][inside]))
    sigma_m = float(np.median(surface.sigma_m[y0:y1, x0:x1][inside]))
    return float(np.sqrt(pixels / (surface.camera.fx * surface.camera.fy))) * depth_m, sigma_m
