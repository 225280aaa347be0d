"""The segmenter without networks: class-agnostic instances from depth and colour, on a CPU.

Room structure is removed, the rest is over-segmented at depth edges, concave creases, support planes and colour edges,
and fragments of one object are merged. It works at a reduced resolution; labels have the frame's.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.perception.fragments.color_split import split_by_color
from hickory_stream.perception.fragments.over_segmentation import (
    Fragments,
    concave_creases,
    fragments_of,
    support_labels,
)
from hickory_stream.perception.masks import enlarged, enlarged_mask, label_boxes
from hickory_stream.perception.regions.join import JoinConfig, Joined, join_fragments
from hickory_stream.perception.regions.map_prior import fragment_owners
from hickory_stream.perception.regions.trees import Trees, embedded_trees
from hickory_stream.perception.structure.detection import StructureConfig
from hickory_stream.perception.structure.room_structure import RoomStructure, room_structure_of
from hickory_stream.perception.surface import Surface, SurfaceConfig, moved_surface, surface_of
from hickory_stream.records import Frame, MapPrior, RejectedMask, Segmentation

# A mask smaller than a square with a side of this many sigmas of depth cannot be distinguished from noise.
_MIN_SIDE_SIGMAS = 2.5
# Minimum visible area of a support plane (horizontal surface of an object), and minimum number of working pixels of
# a connected region of it.
_SUPPORT_AREA_M2 = 0.03
_SUPPORT_AREA_PX = 60


@dataclass(frozen=True, kw_only=True, slots=True)
class GeometricConfig(Ranged):
    """The stages of the geometric segmenter, and which masks it rejects."""

    surface: SurfaceConfig = field(default_factory=SurfaceConfig)
    structure: StructureConfig = field(default_factory=StructureConfig)
    join: JoinConfig = field(default_factory=JoinConfig)
    #: Masks with fewer working pixels are rejected.
    min_area_px: int = number(16, 1, 1_000_000, "px")


class GeometricSegmenter:
    """Segments frames by geometry and colour; stateless. `trees` rate pairs of regions; None: the packaged trees."""

    def __init__(self, config: GeometricConfig, trees: Trees | None = None) -> None:
        self._config = config
        self._trees = trees or embedded_trees()

    def prepare(self, frame: Frame) -> Surface:
        """Return the surface of a frame: the slowest part of segmentation, which needs no map."""
        return surface_of(frame, self._config.surface)

    def moved(self, prepared: object, world_from_camera: NDArray[np.float64]) -> object:
        """Return the result of `prepare` for another pose (4, 4) of the frame."""
        return moved_surface(prepared, world_from_camera) if isinstance(prepared, Surface) else None

    def segment(self, frame: Frame, prior: MapPrior | None = None, prepared: object = None) -> Segmentation:
        """Return the instances and the structure of a frame; `prior` is the map so far."""
        pieces = self.fragments(frame, prior, prepared)
        join = self._config.join
        owners = fragment_owners(pieces.labels, pieces.surface, prior, join.map_prior)
        joined = join_fragments(pieces, self._trees, join, owners)
        return self.segmentation(frame, pieces, joined)

    def segmentation(
        self, frame: Frame, pieces: Fragments, joined: Joined, structure_odds: NDArray[np.float64] | None = None
    ) -> Segmentation:
        """Return the segmentation of a frame from merged fragments.

        `structure_odds` (n + 1,): log-odds that masks 0..n are part of the room; positive ones reject the mask.
        """
        labels, rejected = _usable(pieces.surface, joined.labels, self._config, structure_odds)
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
        """Return the room structure in a frame; `prior` is the map so far."""
        space = None if prior is None else prior.space
        return room_structure_of(surface, space, self._config.structure, _SUPPORT_AREA_M2)

    def divided(self, surface: Surface, room: RoomStructure) -> Fragments:
        """Return the over-segmentation of a surface, excluding structure."""
        floor_z_m = room.floor_z_m
        heights = np.array([p.z_m for p in room.planes if floor_z_m is None or p.z_m > floor_z_m + 0.06])
        supports = support_labels(surface, heights, min_pixels=_SUPPORT_AREA_PX)
        creases = concave_creases(surface, room.structure)
        labels = fragments_of(surface, room.structure, supports, creases)
        boxes = label_boxes(labels, int(labels.max()) + 1)
        labels = split_by_color(labels, boxes, surface.lab)
        return Fragments(surface=surface, room=room, supports=supports, labels=labels)


def _usable(
    surface: Surface, labels: NDArray[np.int32], config: GeometricConfig, structure_odds: NDArray[np.float64] | None
) -> tuple[NDArray[np.int32], tuple[RejectedMask, ...]]:
    count = int(labels.max()) + 1
    pixels = np.bincount(labels.ravel(), minlength=count)
    keep = np.zeros(count, dtype=np.int32)
    rejected: list[RejectedMask] = []
    kept = 0
    boxes = label_boxes(labels, count)
    for i in range(1, count):
        reason = _why_not(surface, labels, i, int(pixels[i]), boxes[i], config)
        if reason is None and structure_odds is not None and structure_odds[i] > 0.0:
            reason = f"part of the room, says the network: log-odds {structure_odds[i]:.1f}"
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
    box: NDArray[np.int64],
    config: GeometricConfig,
) -> str | None:
    if pixels < config.min_area_px:
        return f"{pixels} working pixels, fewer than {config.min_area_px}"
    x0, y0, x1, y1 = box
    inside = labels[y0:y1, x0:x1] == label
    # Every pixel of a fragment has a depth.
    depth_m, sigma_m = (own[y0:y1, x0:x1][inside] for own in (surface.depth_m, surface.sigma_m))
    side = float(np.sqrt(pixels / (surface.camera.fx * surface.camera.fy)))
    if side * float(depth_m.min()) >= _MIN_SIDE_SIGMAS * float(sigma_m.max()):
        return None  # so are the medians
    side_m = side * float(np.median(depth_m))
    if side_m < _MIN_SIDE_SIGMAS * float(np.median(sigma_m)):
        return f"{100 * side_m:.1f} cm in a square, less than {_MIN_SIDE_SIGMAS:g} sigmas of depth"
    return None
