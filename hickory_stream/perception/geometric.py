"""The segmenter without networks: class-agnostic instances from depth and colour, on a CPU.

Room structure is removed, the rest is over-segmented into fragments at depth edges, concave creases, support planes and
colour edges, and fragments of one object are merged. Works at a reduced resolution; labels have that of the frame.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.perception.color_split import ColorSplitConfig, split_by_color
from hickory_stream.perception.fragments import FragmentConfig, concave_creases, fragments_of, support_labels
from hickory_stream.perception.join import JoinConfig, Joined, join_fragments
from hickory_stream.perception.label_boxes import label_boxes
from hickory_stream.perception.map_prior import fragment_owners
from hickory_stream.perception.masks import enlarged, enlarged_mask
from hickory_stream.perception.room_structure import RoomStructure, room_structure_of
from hickory_stream.perception.structure import StructureConfig
from hickory_stream.perception.surface import Surface, SurfaceConfig, surface_of
from hickory_stream.perception.trees import Trees, embedded_trees
from hickory_stream.ranges import Ranged, number
from hickory_stream.records import RejectedMask, Segmentation

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.records import Frame, MapPrior


@dataclass(frozen=True, kw_only=True, slots=True)
class GeometricConfig(Ranged):
    """The stages of the geometric segmenter, and which masks it rejects.

    Attributes:
        min_area_px: masks with fewer working pixels are rejected.
        support_area_m2: minimum visible area of a support plane ...
        support_area_px: ... and minimum number of working pixels of a connected region of it.
    """

    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    structure: StructureConfig = field(default_factory=StructureConfig)
    fragments: FragmentConfig = field(default_factory=FragmentConfig)
    color_split: ColorSplitConfig = field(default_factory=ColorSplitConfig)
    join: JoinConfig = field(default_factory=JoinConfig)
    min_area_px: int = number(16, 1, 1_000_000, "px")
    support_area_m2: float = number(0.03, 0, 1000, "m2")
    support_area_px: int = number(60, 1, 1_000_000, "px")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Fragments:
    """An over-segmented frame at working resolution (h, w): `labels` 1..n, and the support plane of each pixel or 0."""

    surface: Surface
    room: RoomStructure
    supports: NDArray[np.int32]
    labels: NDArray[np.int32]


class GeometricSegmenter:
    """Segments frames by geometry and colour; it has no state but its configuration.

    `trees` rate pairs of regions; None: those of the package.
    """

    def __init__(self, config: GeometricConfig, trees: Trees | None = None) -> None:
        self._config = config
        self._trees = trees or embedded_trees(config.join.forest)

    def prepare(self, frame: Frame) -> Surface:
        """Return the surface of a frame: what takes longest of it, and needs no map."""
        return surface_of(frame, self._config.surface)

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prior` is what the map knows."""
        pieces = self.fragments(frame, prior, prepared)
        join = self._config.join
        owners = fragment_owners(pieces.labels, pieces.surface, prior, join.map_prior)
        joined = join_fragments(pieces.surface, pieces.labels, pieces.supports, pieces.room, self._trees, join, owners)
        return self.segmentation(frame, pieces, joined)

    def segmentation(self, frame: Frame, pieces: Fragments, joined: Joined) -> Segmentation:
        """Return the segmentation of a frame whose fragments were merged into masks."""
        labels, rejected = _usable(pieces.surface, joined.labels, self._config)
        size, factor = (frame.camera.width, frame.camera.height), pieces.surface.factor
        return Segmentation(
            instances=enlarged(labels, factor, size),
            structure=enlarged_mask(pieces.room.structure, factor, size),
            structure_shown=enlarged_mask(pieces.room.shown, factor, size),
            alone=None if joined.alone is None else enlarged(joined.alone, factor, size),
            floor_z_m=pieces.room.floor_z_m,
            rejected=rejected,
        )

    def fragments(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Fragments:
        """Return the over-segmentation of a frame, before any fragments are merged."""
        surface = prepared if isinstance(prepared, Surface) else self.prepare(frame)
        return self.divided(surface, self.room(surface, prior))

    def room(self, surface: Surface, prior: MapPrior | None) -> RoomStructure:
        """Return the room structure in a frame; `prior` is what the map knows so far."""
        space = None if prior is None else prior.space
        return room_structure_of(surface, space, self._config.structure, self._config.support_area_m2)

    def divided(self, surface: Surface, room: RoomStructure) -> Fragments:
        """Return the over-segmentation of a surface without its structure."""
        config, floor_z_m = self._config, room.floor_z_m
        heights = np.array([p.z_m for p in room.planes if floor_z_m is None or p.z_m > floor_z_m + 0.06])
        supports = support_labels(surface, heights, min_pixels=config.support_area_px)
        creases = concave_creases(surface, room.structure, config.fragments)
        labels = fragments_of(surface, room.structure, supports, creases, config.fragments)
        boxes = label_boxes(labels, int(labels.max()) + 1)
        labels = split_by_color(labels, boxes, surface.lab, config.color_split)
        return Fragments(surface=surface, room=room, supports=supports, labels=labels)


def _usable(
    surface: Surface, labels: NDArray[np.int32], config: GeometricConfig
) -> tuple[NDArray[np.int32], tuple[RejectedMask, ...]]:
    """Return the labels of the masks worth lifting, renumbered, and the others with their reasons."""
    count = int(labels.max()) + 1
    pixels = np.bincount(labels.ravel(), minlength=count)
    is_kept = pixels >= config.min_area_px
    is_kept[0] = False
    boxes = label_boxes(labels, count)
    rejected: list[RejectedMask] = []
    for i in (np.flatnonzero(~is_kept[1:]) + 1).tolist():
        x0, y0, x1, y1 = (int(v) * surface.factor for v in boxes[i])
        u0, v0, u1, v1 = boxes[i]
        mask = enlarged_mask(labels[v0:v1, u0:u1] == i, surface.factor, (x1 - x0, y1 - y0))
        reason = f"{pixels[i]} working pixels, fewer than {config.min_area_px}"
        rejected.append(RejectedMask(box_px=(x0, y0, x1, y1), reason=reason, mask=mask))
    numbers = np.where(is_kept, np.cumsum(is_kept), 0).astype(np.int32)
    return numbers[labels], tuple(rejected)
