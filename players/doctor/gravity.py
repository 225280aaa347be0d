"""Checks of gravity: whether the floor is visible, and level in the world of the poses."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.voxels import keys_of_points, sorted_unique
from hickory_stream.mapping.floor_warnings import tilt_warning
from hickory_stream.perception.structure.detection import StructureConfig
from hickory_stream.perception.structure.room_structure import room_structure_of
from hickory_stream.perception.surface import SurfaceConfig, surface_of
from hickory_stream.records import Frame, ObservedSpace

_VOXEL_M, _SUPPORT_M2 = 0.05, 0.03


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class SeenFloor:
    """The floor in one frame: its height, None without a floor, and its sorted voxels."""

    floor_z_m: float | None
    keys: NDArray[np.int64]


def floor_in(frame: Frame) -> SeenFloor:
    """Return the floor that a single frame shows."""
    surface = surface_of(frame, SurfaceConfig())
    room = room_structure_of(surface, None, StructureConfig(), _SUPPORT_M2)
    level = room.shown & (surface.normals_world[..., 2] > 0.9)
    points = surface.points_world[level] if room.floor_z_m is not None else np.empty((0, 3), np.float32)
    return SeenFloor(floor_z_m=room.floor_z_m, keys=sorted_unique(keys_of_points(points, _VOXEL_M)))


def gravity_notes(seen: Sequence[SeenFloor]) -> list[str]:
    """Return the notes on the floor of some frames; none if it is in view and level."""
    heights = [floor.floor_z_m for floor in seen if floor.floor_z_m is not None]
    if not seen:
        return []
    if not heights:
        return [
            f"none of {len(seen)} frames that were looked at shows a floor below the camera: heights above the floor "
            "stay unknown. If the floor is in view, see whether the poses have z upwards"
        ]
    space = ObservedSpace(
        voxel_m=_VOXEL_M,
        free=np.empty(0, dtype=np.int64),
        structure=sorted_unique(np.concatenate([floor.keys for floor in seen])),
        floor_z_m=float(np.median(heights)),
    )
    note = tilt_warning(space)
    return [] if note is None else [note]
