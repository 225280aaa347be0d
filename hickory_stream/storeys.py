"""Storeys of a map: floors at clearly different heights, and the objects on each."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hickory_stream.records import MapSnapshot, Submap

# Floors that are nearer to one another belong to one storey: steps, platforms, the landing of a stair.
_ANOTHER_STOREY_M = 2.0
# Minimum height of a storey.
STOREY_M = 2.4
# A box may reach below the floor that its object stands on, by noise or by a carpet's thickness.
_BELOW_M = 0.3


def floors_of(snapshot: MapSnapshot) -> tuple[float, ...]:
    """Return the heights of the floors in the world, one per storey, lowest first: (lower) medians over the submaps."""
    return tuple(_middle(storey) for storey in _storeys(snapshot))


def floor_of(snapshot: MapSnapshot) -> float:
    """Return the floor of the storey of most submaps; else the lowest point of an object, else 0."""
    storeys = _storeys(snapshot)
    if storeys:
        return _middle(max(storeys, key=len))
    return min((float(tracked.box.corners_world()[:, 2].min()) for tracked in snapshot.objects), default=0.0)


def newest_floor_of(snapshot: MapSnapshot) -> float:
    """Return the floor of the newest submap that saw one, else `floor_of`."""
    newest = max((item for item in snapshot.submaps if _has_floor(item)), key=lambda item: item.id, default=None)
    if newest is None:
        return floor_of(snapshot)
    return min(floors_of(snapshot), key=lambda floor_m: abs(floor_m - floor_height_m(newest)))


def floor_beneath(floors_m: Sequence[float], bottom_z_m: float) -> float:
    """Return the highest floor below a height; the lowest floor if all are above."""
    return max((floor_m for floor_m in floors_m if floor_m <= bottom_z_m + _BELOW_M), default=floors_m[0])


def on_storey(snapshot: MapSnapshot, floor_m: float) -> MapSnapshot:
    """Return the map with only the objects that reach into the storey of this floor; all submaps stay."""
    above_m = min((other for other in floors_of(snapshot) if other > floor_m + _BELOW_M), default=np.inf)
    objects = []
    for tracked in snapshot.objects:
        heights_m = tracked.box.corners_world()[:, 2]
        if heights_m.max() > floor_m - _BELOW_M and heights_m.min() < above_m - _BELOW_M:
            objects.append(tracked)
    return replace(snapshot, objects=tuple(objects))


def floor_height_m(submap: Submap) -> float:
    """Return the height in the world of the floor of a submap that saw one."""
    place = submap.world_from_submap
    return float(place[2, 2] * (submap.observed_space.floor_z_m or 0.0) + place[2, 3])


def _has_floor(submap: Submap) -> bool:
    return submap.observed_space.floor_z_m is not None


def _middle(sorted_m: Sequence[float]) -> float:
    # The lower of two middle ones: between a floor and a platform there is no floor.
    return sorted_m[(len(sorted_m) - 1) // 2]


def _storeys(snapshot: MapSnapshot) -> list[list[float]]:
    storeys: list[list[float]] = []
    for height_m in sorted(floor_height_m(submap) for submap in snapshot.submaps if _has_floor(submap)):
        if not storeys or height_m - storeys[-1][0] > _ANOTHER_STOREY_M:
            storeys.append([])
        storeys[-1].append(height_m)
    return storeys
