"""The observed structure: the floor as faint points, the walls of each submap as a mesh.

Only faces that look into free space are drawn, and only from their side, so that near walls hide nothing.
"""

from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.voxels import centers_of_keys
from hickory_stream.pictures.render_parts import wall_surface
from hickory_stream.records import MapSnapshot, SpaceObservation, Submap
from hickory_stream.sinks.rerun.items import LogItem, Span, Weight, clear_item
from hickory_stream.sinks.rerun.labels import FLOOR_COLOR, WALLS_COLOR
from hickory_stream.sinks.rerun.meshes import mesh_of_surface

FLOOR, WALLS = "world/structure/floor", "world/structure/walls"
_MAX_POINTS = _MAX_FACES = 20_000
_FLOOR_BAND_M = 0.10
# Logged again when so much larger, or after so many keyframes.
_GROWTH, _MOST_KEYFRAMES = 1.5, 20
_NONE = np.zeros((0, 3), np.float32)


class Structure:
    """The structure of a map; only changed submaps are read again."""

    def __init__(self) -> None:
        self._parts: dict[int, _Part] = {}
        self._age = 0

    def grown(self, snapshot: MapSnapshot, seen: SpaceObservation | None) -> list[LogItem]:
        """Return the items if the structure grew by half, or is old; before there is any, what this keyframe saw."""
        self._age += 1
        count, before = 0, 0
        for submap in snapshot.submaps:
            part = self._parts.get(submap.id)
            # The arrays of a submap that stays are not looked at: they may be compressed.
            if part is None or part.submap.observed_space is not submap.observed_space:
                count, before = count + len(submap.observed_space.structure), before + (part.count if part else 0)
        if count > _GROWTH * before or (self._parts and self._age >= _MOST_KEYFRAMES):
            self._age = 0
            return self.items(snapshot)
        if self._parts or seen is None or not snapshot.submaps:
            return []
        last = snapshot.submaps[-1]
        space = replace(last.observed_space, structure=seen.structure_keys, free=seen.free_keys)
        submap = replace(last, observed_space=replace(space, floor_z_m=seen.floor_z_m))
        items = self.items(replace(snapshot, submaps=(submap,)))
        self._parts = {}
        return items

    def items(self, snapshot: MapSnapshot) -> list[LogItem]:
        """Return the structure voxels of all submaps."""
        before = self._parts
        self._parts = {
            submap.id: known if known is not None and known.submap is submap else _part_of(submap)
            for submap, known in ((submap, before.get(submap.id)) for submap in snapshot.submaps)
        }
        floor = np.concatenate([_NONE, *(part.floor for part in self._parts.values())])
        kept = np.linspace(0, max(len(floor) - 1, 0), min(len(floor), _MAX_POINTS)).astype(np.int64)
        cloud = rr.Points3D(floor[kept], colors=FLOOR_COLOR, radii=-1.2)
        items = [LogItem(path=FLOOR, archetypes=(cloud,), weight=Weight.HEAVY, span=Span.LASTING)]
        for part in self._parts.values():
            if before.get(part.submap.id) is not part:
                path = f"{WALLS}/{part.submap.id}"
                items.append(LogItem(path=path, archetypes=(part.walls,), weight=Weight.HEAVY, span=Span.LASTING))
        return [*items, *(clear_item(f"{WALLS}/{i}") for i in sorted(before.keys() - self._parts.keys()))]


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    submap: Submap
    floor: NDArray[np.float32]
    walls: rr.Mesh3D
    count: int


def _part_of(submap: Submap) -> _Part:
    space = submap.observed_space
    centers = centers_of_keys(space.structure, space.voxel_m)
    # Without a floor in view, all is walls.
    floor_m = space.floor_z_m if space.floor_z_m is not None else float(centers[:, 2].min(initial=0.0)) - 0.2
    is_floor = np.abs(centers[:, 2] - floor_m) <= _FLOOR_BAND_M
    surface = wall_surface(submap, floor_m + float(submap.world_from_submap[2, 3]), None, _MAX_FACES)
    walls = mesh_of_surface(surface, albedo_factor=WALLS_COLOR, face_rendering=rr.components.MeshFaceRendering.Front)
    return _Part(submap, apply(submap.world_from_submap, centers[is_floor]), walls, len(centers))
