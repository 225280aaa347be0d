"""Room structure (floor, walls, ceiling) in a frame, by the frame itself and by the map; shared by all segmenters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.voxels import first_not_below, key_of_point
from hickory_stream.perception.structure.detection import (
    FLOOR_AREA_M2,
    HorizontalPlane,
    StructureConfig,
    floor_height_m,
    horizontal_planes,
    pixel_areas_m2,
    structure_mask,
)
from hickory_stream.perception.structure.ground import uneven_ground
from hickory_stream.perception.structure.raised_patches import raised_patches

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.perception.surface import Surface
    from hickory_stream.records import ObservedSpace


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RoomStructure:
    """Room structure in a frame, at working resolution (h, w).

    `areas_m2` (h, w): surface area of each pixel; `planes`: horizontal planes; `floor_z_m`: height of the floor, None
    if unknown; `structure` (h, w) bool: floor, walls and ceiling, by this frame or the map; `shown` (h, w) bool: by
    this frame alone.
    """

    areas_m2: NDArray[np.float32]
    planes: list[HorizontalPlane]
    floor_z_m: float | None
    structure: NDArray[np.bool_]
    shown: NDArray[np.bool_]


def room_structure_of(
    surface: Surface, prior: ObservedSpace | None, config: StructureConfig, support_area_m2: float
) -> RoomStructure:
    """Return the structure in a frame; `prior` is the observed space of the map so far, None at the start."""
    areas_m2 = pixel_areas_m2(surface)
    planes = horizontal_planes(surface, areas_m2, min_area_m2=support_area_m2)
    known_floor = prior.floor_z_m if prior is not None else None
    floor_z_m = floor_height_m(surface, planes, known_floor, config)
    known = _known_structure(surface, prior)
    ground = uneven_ground(
        surface,
        known,
        floor_z_m,
        config.ground,
        below_camera_m=config.floor_below_camera_m,
        least_m2=FLOOR_AREA_M2,
    )
    if ground is not None:
        floor_z_m = ground.middle_z_m
    shown, planes_near = structure_mask(surface, areas_m2, floor_z_m, ground)
    # Raised patches are removed from the map's structure, too: its voxels are coarser than such a patch.
    structure = shown | known
    off = raised_patches(planes_near, structure, surface)
    return RoomStructure(
        areas_m2=areas_m2, planes=planes, floor_z_m=floor_z_m, structure=structure & ~off, shown=shown & ~off
    )


def _known_structure(surface: Surface, prior: ObservedSpace | None) -> NDArray[np.bool_]:
    """Return (h, w) the pixels in structure voxels of the map: these find a wall of which the frame shows little."""
    if prior is None or len(prior.structure) == 0:
        return np.zeros(surface.depth_m.shape, dtype=bool)
    mask: NDArray[np.bool_] = _in_voxels(surface.points_world, prior.structure, prior.voxel_m)
    return mask


@kernel
def _in_voxels(points, sorted_keys, voxel_m):
    """Return (h, w) which points lie in voxels of sorted keys; False for NaN. Neighbours mostly share one look-up."""
    height, width, _ = points.shape
    mask = np.zeros((height, width), dtype=np.bool_)
    last, at, is_in = np.int64(-1), 0, False
    for y in range(height):
        for x in range(width):
            if np.isnan(points[y, x, 2]):
                continue
            key = key_of_point(points[y, x, 0], points[y, x, 1], points[y, x, 2], voxel_m)
            if key != last:
                last, at = key, first_not_below(sorted_keys, key, at)
                is_in = at < len(sorted_keys) and sorted_keys[at] == key
            mask[y, x] = is_in
    return mask
