"""The observed structure as faint points: the floor, and separately the walls, which hide the room from outside."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import centers_of_keys
from hickory_stream.records import MapSnapshot, SpaceObservation, Submap
from hickory_stream.sinks.rerun.items import LogItem, Span, Weight

FLOOR, WALLS = "world/structure/floor", "world/structure/walls"
_MAX_POINTS = 20_000
_FLOOR_BAND_M = 0.10
# Logged again when so much larger, or after so many keyframes.
_GROWTH, _MOST_KEYFRAMES = 1.25, 20
_NONE = np.zeros((0, 3), np.float32)


class Structure:
    """The structure of a map; only changed submaps are read again."""

    def __init__(self) -> None:
        self._parts: dict[int, _Part] = {}
        self._count, self._age = 0, 0

    def grown(self, snapshot: MapSnapshot, seen: SpaceObservation | None) -> list[LogItem]:
        """Return the items if the structure grew by a quarter, or is old; before there is any, what a keyframe saw."""
        count = sum(len(submap.observed_space.structure) for submap in snapshot.submaps)
        self._age += 1
        if count == 0 and self._count == 0 and seen is not None and snapshot.submaps:
            space = replace(
                snapshot.submaps[-1].observed_space, structure=seen.structure_keys, floor_z_m=seen.floor_z_m
            )
            return self.items(replace(snapshot, submaps=(replace(snapshot.submaps[-1], observed_space=space),)))
        if self._age < _MOST_KEYFRAMES and count <= _GROWTH * self._count:
            return []
        self._count, self._age = count, 0
        return self.items(snapshot)

    def items(self, snapshot: MapSnapshot) -> list[LogItem]:
        """Return the structure voxels of all submaps."""
        before = self._parts
        self._parts = {
            submap.id: known if known is not None and known.submap is submap else _part_of(submap)
            for submap, known in ((submap, before.get(submap.id)) for submap in snapshot.submaps)
        }
        items = []
        for path, name, color in ((FLOOR, "floor", (92, 98, 110)), (WALLS, "walls", (70, 78, 92))):
            points = np.concatenate([_NONE, *(getattr(part, name) for part in self._parts.values())])
            kept = np.linspace(0, max(len(points) - 1, 0), min(len(points), _MAX_POINTS)).astype(np.int64)
            cloud = rr.Points3D(points[kept], colors=color, radii=-1.2)
            items.append(LogItem(path=path, archetypes=(cloud,), weight=Weight.HEAVY, span=Span.LASTING))
        return items


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    submap: Submap
    floor: NDArray[np.float32]
    walls: NDArray[np.float32]


def _part_of(submap: Submap) -> _Part:
    space = submap.observed_space
    centers = centers_of_keys(space.structure, space.voxel_m)
    is_floor = np.zeros(len(centers), dtype=bool)
    if space.floor_z_m is not None:
        is_floor = np.abs(centers[:, 2] - space.floor_z_m) <= _FLOOR_BAND_M
    centers = apply(submap.world_from_submap, centers)
    return _Part(submap, centers[is_floor], centers[~is_floor])
