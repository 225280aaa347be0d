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
from hickory_stream.records import MapSnapshot, ObservedSpace, SpaceObservation, Submap
from hickory_stream.sinks.rerun.items import LogItem, Span, Weight, clear_item, pose_item
from hickory_stream.sinks.rerun.labels import FLOOR_COLOR, WALLS_COLOR
from hickory_stream.sinks.rerun.meshes import mesh_of_surface

FLOOR, WALLS = "world/structure/floor", "world/structure/walls"
_MAX_POINTS = _MAX_FACES = 20_000
_FLOOR_BAND_M = 0.10
# Logged again when so much larger, or after so many keyframes.
_GROWTH, _MOST_KEYFRAMES = 1.5, 20
_NONE = np.zeros((0, 3))
_AT_ORIGIN = np.eye(4)


class Structure:
    """The structure of a map; only changed submaps are read again.

    Walls lie in the frame of their submap: a correction logs a pose.
    """

    def __init__(self) -> None:
        self._parts: dict[int, _Part] = {}
        self._spaces: dict[int, ObservedSpace] = {}
        self._age = 0

    def grown(self, snapshot: MapSnapshot, seen: SpaceObservation | None) -> list[LogItem]:
        """Return the items if the open submap grew by half or moved, or they are old; at first, of this keyframe."""
        self._age += 1
        if not snapshot.submaps:
            return []
        last = snapshot.submaps[-1]
        known = self._parts.get(last.id)
        is_same = known is not None and known.space is last.observed_space
        has_grown = not is_same and len(last.observed_space.structure) > _GROWTH * (known.count if known else 0)
        has_moved = known is not None and not np.array_equal(known.place, last.world_from_submap)
        if has_grown or has_moved or (self._parts and self._age >= _MOST_KEYFRAMES):
            return self.items(snapshot, is_settled=False)
        if self._parts or seen is None:
            return []
        space = replace(last.observed_space, structure=seen.structure_keys, free=seen.free_keys)
        submap = replace(last, observed_space=replace(space, floor_z_m=seen.floor_z_m))
        items = self.items(replace(snapshot, submaps=(submap,)))
        self._parts = {}
        return items

    def items(self, snapshot: MapSnapshot, *, is_settled: bool = True) -> list[LogItem]:
        """Return the structure of all submaps; while it is not settled, ended ones are drawn once they rest."""
        before, resting = self._parts, self._spaces
        self._parts, is_old = {}, is_settled or self._age >= _MOST_KEYFRAMES
        if is_old:
            self._age, self._spaces = 0, {submap.id: submap.observed_space for submap in snapshot.submaps}
        items = []
        for submap in snapshot.submaps:
            part, path = before.get(submap.id), f"{WALLS}/{submap.id}"
            is_at_rest = is_old and resting.get(submap.id) is submap.observed_space
            is_due = is_settled or submap is snapshot.submaps[-1] or is_at_rest
            if part is None or (is_due and part.space is not submap.observed_space):
                part = _part_of(submap, _AT_ORIGIN if part is None else part.place)
                items.append(LogItem(path=path, archetypes=(part.walls,), weight=Weight.HEAVY, span=Span.LASTING))
            if not np.array_equal(part.place, submap.world_from_submap):
                part = replace(part, place=submap.world_from_submap)
                items.append(pose_item(path, part.place))
            self._parts[submap.id] = part
        floor = np.concatenate([_NONE, *(apply(part.place, part.floor) for part in self._parts.values())])
        kept = np.linspace(0, max(len(floor) - 1, 0), min(len(floor), _MAX_POINTS)).astype(np.int64)
        cloud = rr.Points3D(floor[kept], colors=FLOOR_COLOR, radii=-1.2)
        items.insert(0, LogItem(path=FLOOR, archetypes=(cloud,), weight=Weight.HEAVY, span=Span.LASTING))
        return [*items, *(clear_item(f"{WALLS}/{i}") for i in sorted(before.keys() - self._parts.keys()))]


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    space: ObservedSpace
    # In the submap's frame, which was logged at `place`.
    floor: NDArray[np.float64]
    walls: rr.Mesh3D
    count: int
    place: NDArray[np.float64]


def _part_of(submap: Submap, place: NDArray[np.float64]) -> _Part:
    # A copy that holds its arrays: those of a submap out of use are made anew whenever they are read.
    space = replace(submap.observed_space)
    centers = centers_of_keys(space.structure, space.voxel_m)
    # Without a floor in view, all is walls.
    floor_m = space.floor_z_m if space.floor_z_m is not None else float(centers[:, 2].min(initial=0.0)) - 0.2
    is_floor = np.abs(centers[:, 2] - floor_m) <= _FLOOR_BAND_M
    own = Submap(id=submap.id, world_from_submap=_AT_ORIGIN, observed_space=space)
    surface = wall_surface(own, lambda points: points[:, 2] - floor_m, None, _MAX_FACES)
    walls = mesh_of_surface(surface, albedo_factor=WALLS_COLOR, face_rendering=rr.components.MeshFaceRendering.Front)
    return _Part(submap.observed_space, centers[is_floor], walls, len(centers), place)
