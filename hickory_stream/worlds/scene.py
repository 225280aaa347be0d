"""A world: models with poses, and the structure around them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.boxes import OrientedBox, intersection_volume_m3
from hickory_stream.geometry.rigid import apply, from_rotation_translation, yaw_rotation
from hickory_stream.worlds.lighting import Lighting
from hickory_stream.worlds.object_models import Model

# Touching faces may share a sliver by rounding; up to a cubic millimetre is ignored.
_SLIVER_M3 = 1e-9


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class WorldObject:
    """A model with its pose; `id` >= 1."""

    id: int
    model: Model
    world_from_object: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "world_from_object", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class World:
    """Objects sorted by id, and structure models in the world frame."""

    objects: tuple[WorldObject, ...]
    structure: tuple[Model, ...]
    #: (x0, y0, x1, y1) between the walls of each room.
    rooms_m: tuple[tuple[float, float, float, float], ...]
    #: The centre (x, y) of the walk in a world of one room.
    middle_m: tuple[float, float]
    #: None: two lamps under the ceiling of each room.
    lighting: Lighting | None = None

    @property
    def interior_m(self) -> tuple[float, float, float, float]:
        """The rectangle (x0, y0, x1, y1) around all rooms."""
        x0, y0, x1, y1 = zip(*self.rooms_m, strict=True)
        return min(x0), min(y0), max(x1), max(y1)


def at_place(x: float, y: float, z: float, yaw_rad: float) -> NDArray[np.float64]:
    """Return the pose of an upright object: `a_from_b` (4, 4)."""
    return from_rotation_translation(yaw_rotation(yaw_rad), np.array([x, y, z]))


def part_boxes(model: Model, world_from_object: NDArray[Any], margin_m: float = 0.0) -> list[OrientedBox]:
    """Return the box around each part, enlarged by `margin_m`, but only horizontally, since objects are stacked."""
    boxes = []
    for part in model.parts:
        lower, upper = part.vertices.min(axis=0), part.vertices.max(axis=0)
        object_from_box = from_rotation_translation(np.eye(3), (lower + upper) / 2)
        half = (upper - lower) / 2 + (margin_m, margin_m, 0.0)
        boxes.append(OrientedBox(world_from_box=world_from_object @ object_from_box, half_extents_m=half))
    return boxes


def shared_volume_m3(a: Sequence[OrientedBox], b: Sequence[OrientedBox]) -> float:
    """Return the volume that two sets of part boxes share, summed over all pairs; slivers are ignored."""
    if _are_apart(a, b):
        return 0.0
    volumes = (intersection_volume_m3(x, y) for x in a for y in b)
    return sum(volume for volume in volumes if volume > _SLIVER_M3)


def _are_apart(a: Sequence[OrientedBox], b: Sequence[OrientedBox]) -> bool:
    (a_low, a_high), (b_low, b_high) = _bounds(a), _bounds(b)
    return bool((a_low > b_high).any() or (b_low > a_high).any())


def _bounds(boxes: Sequence[OrientedBox]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    corners = np.concatenate([box.corners_world() for box in boxes])
    return corners.min(axis=0), corners.max(axis=0)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Placement:
    """A model with its pose, before it has an id."""

    model: Model
    world_from_object: NDArray[np.float64]

    def fits(self, others: "Sequence[Placement]", margin_m: float) -> bool:
        """Return whether it keeps a horizontal distance of `margin_m` from every part of every other placement."""
        near = [other for other in others if self._may_touch(other, margin_m)]
        mine = part_boxes(self.model, self.world_from_object, margin_m) if near else []
        return all(shared_volume_m3(mine, part_boxes(other.model, other.world_from_object)) == 0.0 for other in near)

    def _may_touch(self, other: "Placement", margin_m: float) -> bool:
        # Whether the spheres around both overlap: a test before anything is computed of parts.
        (mine, reach), (theirs, their_reach) = _sphere(self.model), _sphere(other.model)
        gap = apply(self.world_from_object, mine) - apply(other.world_from_object, theirs)
        # The margin widens every part to both sides.
        return float(np.linalg.norm(gap)) <= reach + their_reach + 2 * margin_m


@lru_cache(maxsize=4096)
def _sphere(model: Model) -> tuple[NDArray[np.float64], float]:
    # Centre (1, 3) and radius.
    lower, upper = model.bounds_m()
    return ((lower + upper) / 2)[None], float(np.linalg.norm(upper - lower)) / 2


def numbered(placements: Sequence[Placement]) -> tuple[WorldObject, ...]:
    """Return the placements as objects with the ids 1, 2, ... in their order."""
    return tuple(
        WorldObject(id=i, model=placed.model, world_from_object=placed.world_from_object)
        for i, placed in enumerate(placements, start=1)
    )


def placed_otherwise(world: World, other: World) -> tuple[WorldObject, ...]:
    """Return the objects of a world that are elsewhere in another one, or not in it at all."""
    places = {item.id: item.world_from_object.tolist() for item in other.objects}
    return tuple(item for item in world.objects if places.get(item.id) != item.world_from_object.tolist())
