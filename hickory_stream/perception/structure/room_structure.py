"""Room structure (floor, walls, ceiling) in a frame, by the frame and the map; shared by all segmenters."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.geometry.voxels import first_not_below, key_of_point
from hickory_stream.perception.structure import detection
from hickory_stream.perception.structure.detection import HorizontalPlane, StructureConfig
from hickory_stream.perception.structure.ground import uneven_ground
from hickory_stream.perception.surface import Surface
from hickory_stream.records import ObservedSpace


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class RoomStructure:
    """Room structure in a frame, at working resolution (h, w)."""

    areas_m2: NDArray[np.float32]
    planes: list[HorizontalPlane]
    #: height of the floor, None if unknown
    floor_z_m: float | None
    #: floor, walls and ceiling, by this frame or the map
    structure: NDArray[np.bool_]
    #: the same by this frame alone
    shown: NDArray[np.bool_]


def room_structure_of(
    surface: Surface, prior: ObservedSpace | None, config: StructureConfig, support_area_m2: float
) -> RoomStructure:
    """Return the structure in a frame; `prior` is the observed space of the map, None at the start."""
    areas_m2 = detection.pixel_areas_m2(surface)
    planes = detection.horizontal_planes(surface, areas_m2, min_area_m2=support_area_m2)
    known_floor = prior.floor_z_m if prior is not None else None
    floor_z_m = detection.floor_height_m(surface, planes, known_floor, config)
    known = np.zeros(surface.depth_m.shape, dtype=bool)
    if prior is not None and len(prior.structure):
        # Structure voxels of the map find a wall of which the frame shows little.
        known = _in_voxels(surface.points_world, prior.structure, prior.voxel_m)
    below_m, least_m2 = config.floor_below_camera_m, detection.FLOOR_AREA_M2
    ground = uneven_ground(surface, known, floor_z_m, config.ground, below_camera_m=below_m, least_m2=least_m2)
    if ground is not None:
        floor_z_m = ground.middle_z_m
    shown = detection.structure_mask(surface, areas_m2, floor_z_m, ground)
    return RoomStructure(areas_m2=areas_m2, planes=planes, floor_z_m=floor_z_m, structure=shown | known, shown=shown)


@kernel
def _in_voxels(points, sorted_keys, voxel_m):
    # (h, w); False for NaN. Neighbours mostly share one look-up.
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
