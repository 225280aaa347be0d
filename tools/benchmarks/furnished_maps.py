"""Object maps of furnished places without rendering: the objects of `hickory_stream.worlds`, seen with noise.

The layer 3 of an object is the box of each of its parts, its descriptor that of its kind and of an instance (as in
`evaluation.maps.simulate`, whose noise this is). Furniture stands as people put it: along walls, in groups, at the
heights of floors and tables, and two apartments have the same kinds of things. There is no observed space.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.evaluation.maps.simulate import Difficulty, SimulatedPair, SimulatedWorld, random_pose
from hickory_stream.geometry.rigid import apply, from_rotation_translation, invert
from hickory_stream.geometry.superquadric import Superquadrics, moved, sorted_by_volume
from hickory_stream.worlds.apartment import apartment
from hickory_stream.worlds.furnishing import FURNISH, Room
from hickory_stream.worlds.furniture import chair
from hickory_stream.worlds.scene import at_place

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.evaluation.maps.ambiguous import Corner
    from hickory_stream.evaluation.maps.simulate import SimulatedObject
    from hickory_stream.worlds.object_models import Model
    from hickory_stream.worlds.scene import Placement, WorldObject

_SEEN = 0.8
_MIN_SIDE_M = 1.0
_EXPONENT, _MIN_HALF_M = 0.3, 0.005
_DRAWS = 4


def unrelated_apartments(seed: int, difficulty: Difficulty) -> SimulatedPair:
    """Return maps of two apartments of different seeds: nothing is in both."""
    rng = np.random.default_rng([seed, 31])
    world = SimulatedWorld(difficulty, rng)
    one, other = (_objects_of(world, apartment(2 * seed + i).objects) for i in (0, 1))
    return _pair(world, [*one, *other], _seen(len(one), len(other), 0, rng), rng)


def shared_apartment(seed: int, difficulty: Difficulty) -> SimulatedPair:
    """Return two maps of one apartment: of its four rooms each has three, and two are in both."""
    rng = np.random.default_rng([seed, 32])
    world = SimulatedWorld(difficulty, rng)
    place = apartment(seed)
    rooms = np.array([_room_of(item, place.rooms_m) for item in place.objects])
    order = rng.permutation(len(place.rooms_m))
    in_a, in_b = rooms != order[0], rooms != order[1]
    seen = [part & (rng.random(len(rooms)) < _SEEN) for part in (in_a, in_b)]
    return _pair(world, _objects_of(world, place.objects), (seen[0], seen[1]), rng)


def furnished(
    world: SimulatedWorld, rng: np.random.Generator, count: int, low_m: Corner, high_m: Corner
) -> list[SimulatedObject]:
    """Return so many objects of furnished rooms in a rectangle; a chair where it is no room (`ambiguous.Draw`)."""
    if min(high_m[0] - low_m[0], high_m[1] - low_m[1]) < _MIN_SIDE_M:
        return [_object_of(world, chair(rng), at_place(*low_m, 0.0, rng.uniform(0, 2 * np.pi))) for _ in range(count)]
    placed: list[Placement] = []
    for _ in range(_DRAWS):
        room = Room(rectangle_m=(*low_m, *high_m), keep_free_m=(), placed=placed)
        placed = FURNISH[int(rng.integers(len(FURNISH)))](rng, room)
        if len(placed) >= count:
            break
    kept = rng.permutation(len(placed))[:count]
    return [_object_of(world, placed[i].model, placed[i].world_from_object) for i in kept]


def _pair(
    world: SimulatedWorld,
    objects: list[SimulatedObject],
    seen: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    rng: np.random.Generator,
) -> SimulatedPair:
    in_a, in_b = (rng.permutation(np.flatnonzero(part)) for part in seen)
    a_from_world, b_from_world = random_pose(0.0, 8.0, rng), random_pose(0.0, 8.0, rng)
    both, rank_a, rank_b = np.intersect1d(in_a, in_b, return_indices=True)
    places = np.array([objects[i].place for i in both]).reshape(-1, 3)
    return SimulatedPair(
        map_a=world.observe([objects[i] for i in in_a], a_from_world),
        map_b=world.observe([objects[i] for i in in_b], b_from_world),
        a_from_b=a_from_world @ invert(b_from_world),
        common=np.stack([rank_a, rank_b], axis=1).astype(np.int64),
        common_centroids_a=apply(a_from_world, places),
    )


def _seen(
    num_one: int, num_other: int, num_common: int, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    is_seen = rng.random(num_one + num_other) < _SEEN
    is_one = np.arange(num_one + num_other) < num_one
    return is_seen & is_one, is_seen & ~is_one


def _room_of(item: WorldObject, rooms_m: Sequence[tuple[float, float, float, float]]) -> int:
    x, y = item.world_from_object[:2, 3]
    centers = np.array([((x0 + x1) / 2, (y0 + y1) / 2) for x0, y0, x1, y1 in rooms_m])
    return int(np.argmin(np.hypot(*(centers - [x, y]).T)))


def _objects_of(world: SimulatedWorld, items: Sequence[WorldObject]) -> list[SimulatedObject]:
    return [_object_of(world, item.model, item.world_from_object) for item in items]


def _object_of(world: SimulatedWorld, model: Model, world_from_object: NDArray[np.float64]) -> SimulatedObject:
    boxes = [(part.vertices.min(axis=0), part.vertices.max(axis=0)) for part in model.parts]
    shape = Superquadrics(
        exponents=np.full((len(boxes), 2), _EXPONENT),
        semi_axes_m=np.array([np.maximum((high - low) / 2, _MIN_HALF_M) for low, high in boxes]),
        world_from_local=np.array([from_rotation_translation(np.eye(3), (low + high) / 2) for low, high in boxes]),
    )
    return world.object_of(sorted_by_volume(moved(shape, world_from_object)), _number_of(model.kind))


@cache
def _number_of(kind: str) -> int:
    """Return a number of a kind that no run changes."""
    return sum(letter * (i + 1) for i, letter in enumerate(kind.encode()))
