"""The observed structure as faint points: the floor, and apart from it the walls, which hide the room from outside."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import rerun as rr

from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import centers_of_keys
from hickory_stream.sinks.rerun_items import LogItem, Span, Weight

if TYPE_CHECKING:
    from hickory_stream.records import MapSnapshot

FLOOR, WALLS = "world/structure/floor", "world/structure/walls"
_MAX_POINTS = 20_000
_FLOOR_BAND_M = 0.10


def structure_items(snapshot: MapSnapshot) -> list[LogItem]:
    """Return the structure voxels of all submaps."""
    floor, walls = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.float32)]
    for submap in snapshot.submaps:
        space = submap.observed_space
        centers = centers_of_keys(space.structure, space.voxel_m)
        is_floor = np.zeros(len(centers), dtype=bool)
        if space.floor_z_m is not None:
            is_floor = np.abs(centers[:, 2] - space.floor_z_m) <= _FLOOR_BAND_M
        centers = apply(submap.world_from_submap, centers)
        floor.append(centers[is_floor])
        walls.append(centers[~is_floor])
    items = []
    for path, parts, color in ((FLOOR, floor, (92, 98, 110)), (WALLS, walls, (70, 78, 92))):
        points = np.concatenate(parts)
        kept = np.linspace(0, max(len(points) - 1, 0), min(len(points), _MAX_POINTS)).astype(np.int64)
        cloud = rr.Points3D(points[kept], colors=color, radii=-1.2)
        items.append(LogItem(path=path, archetypes=(cloud,), weight=Weight.HEAVY, span=Span.LASTING))
    return items
