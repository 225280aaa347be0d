"""Object maps of furnished places without rendering: the objects of `hickory_stream.worlds`, seen with noise."""
# Layer 3 has a box for each part; descriptors are drawn by kind and instance, with the noise of `simulate`. There is no
# observed space.

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.geometry.superquadric import Superquadrics, moved, sorted_by_volume
from hickory_stream.worlds.furniture import chair
from hickory_stream.worlds.object_models import Model
from hickory_stream.worlds.scene import Placement, at_place
from tools.evaluation.simulated_maps.ambiguous import Corner
from tools.evaluation.simulated_maps.simulate import (
    Difficulty,
    SimulatedObject,
    SimulatedPair,
    SimulatedWorld,
    random_pose,
)
from tools.worlds.apartment import apartment
from tools.worlds.furnishing import FURNISH, Room

_SEEN, _REACH_M = 0.8, 8.0
_MIN_SIDE_M = 1.0
_EXPONENT, _MIN_HALF_M = 0.3, 0.005
_DRAWS = 4


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class _Furniture:
    shape: Superquadrics
    kind: int
    room: int


def unrelated_apartments(seeds: tuple[int, int], difficulty: Difficulty) -> SimulatedPair:
    """Return maps of two apartments of different seeds: nothing is in both."""
    rng = np.random.default_rng([*seeds, 31])
    world = SimulatedWorld(difficulty, rng)
    one, other = (_new(world, _apartment(seed)) for seed in seeds)
    is_one = np.arange(len(one) + len(other)) < len(one)
    is_seen = rng.random(len(is_one)) < _SEEN
    return _pair(world, [*one, *other], (is_seen & is_one, is_seen & ~is_one), rng)


def shared_apartment(seed: int, difficulty: Difficulty) -> SimulatedPair:
    """Return two maps of one apartment: of its four rooms each has three, and two are in both."""
    rng = np.random.default_rng([seed, 32])
    world = SimulatedWorld(difficulty, rng)
    furniture = _apartment(seed)
    rooms = np.array([item.room for item in furniture])
    left_out = rng.permutation(rooms.max() + 1)
    in_a, in_b = ((rooms != room) & (rng.random(len(rooms)) < _SEEN) for room in left_out[:2])
    return _pair(world, _new(world, furniture), (in_a, in_b), rng)


def furnished(
    world: SimulatedWorld, rng: np.random.Generator, count: int, low_m: Corner, high_m: Corner
) -> list[SimulatedObject]:
    """Return so many objects of furnished rooms in a rectangle; a chair where it is no room (`ambiguous.Draw`)."""
    if min(high_m[0] - low_m[0], high_m[1] - low_m[1]) < _MIN_SIDE_M:
        stood = [(chair(rng), at_place(*low_m, 0.0, rng.uniform(0, 2 * np.pi))) for _ in range(count)]
        return _new(world, [_furniture(model, pose, 0) for model, pose in stood])
    placed: list[Placement] = []
    for _ in range(_DRAWS):
        room = Room(rectangle_m=(*low_m, *high_m), keep_free_m=(), placed=placed)
        placed = FURNISH[int(rng.integers(len(FURNISH)))](rng, room)
        if len(placed) >= count:
            break
    kept = rng.permutation(len(placed))[:count]
    return _new(world, [_furniture(placed[i].model, placed[i].world_from_object, 0) for i in kept])


def _pair(
    world: SimulatedWorld,
    objects: list[SimulatedObject],
    seen: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    rng: np.random.Generator,
) -> SimulatedPair:
    in_a, in_b = (rng.permutation(np.flatnonzero(part)) for part in seen)
    a_from_world, b_from_world = (random_pose(0.0, _REACH_M, rng) for _ in seen)
    return world.pair(objects, in_a, in_b, a_from_world, b_from_world)


def _new(world: SimulatedWorld, furniture: Sequence[_Furniture]) -> list[SimulatedObject]:
    return [world.object_of(item.shape, item.kind) for item in furniture]


@cache
def _apartment(seed: int) -> tuple[_Furniture, ...]:
    place = apartment(seed)
    middles = np.array([((x0 + x1) / 2, (y0 + y1) / 2) for x0, y0, x1, y1 in place.rooms_m])
    return tuple(
        _furniture(
            item.model, item.world_from_object, int(np.argmin(np.hypot(*(middles - item.world_from_object[:2, 3]).T)))
        )
        for item in place.objects
    )


def _furniture(model: Model, world_from_object: NDArray[np.float64], room: int) -> _Furniture:
    boxes = [(part.vertices.min(axis=0), part.vertices.max(axis=0)) for part in model.parts]
    shape = Superquadrics(
        exponents=np.full((len(boxes), 2), _EXPONENT),
        semi_axes_m=np.array([np.maximum((high - low) / 2, _MIN_HALF_M) for low, high in boxes]),
        world_from_local=np.array([from_rotation_translation(np.eye(3), (low + high) / 2) for low, high in boxes]),
    )
    # A number that no run changes, of which a simulated world takes the remainder.
    kind = sum(letter * place for place, letter in enumerate(model.kind.encode(), start=1))
    return _Furniture(shape=sorted_by_volume(moved(shape, world_from_object)), kind=kind, room=room)
