"""An apartment from a seed: four rooms around a crossing of walls, joined by open doors."""

from dataclasses import dataclass

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.worlds.scene import Placement, World, numbered
from tools.worlds.furnishing import FURNISH, Room
from tools.worlds.routes import joins_rooms
from tools.worlds.structure import DoorWay, apartment_structure, drawn_door

_ATTEMPTS = 60
_WALL_M = 0.1
_CLEARANCE_M = 0.3
_MIN_OBJECTS, _MAX_OBJECTS, _MIN_KINDS = 25, 45, 20


@dataclass(frozen=True, kw_only=True, slots=True)
class _Plan:
    rooms_m: tuple[tuple[float, float, float, float], ...]
    doors: tuple[DoorWay, ...]


def apartment(seed: int, attempt: int = 0) -> World:
    """Return apartment number `attempt` of a seed, with 25 to 45 objects of at least 20 kinds."""
    # Raises ConfigError: no draw fits, which no seed has shown so far.
    rng = np.random.default_rng([seed, 11, attempt])
    for _ in range(_ATTEMPTS):
        world = _draw(rng)
        kinds = {item.model.kind for item in world.objects}
        if _MIN_OBJECTS <= len(world.objects) <= _MAX_OBJECTS and len(kinds) >= _MIN_KINDS:
            if joins_rooms(world, _CLEARANCE_M):
                return world
    raise ConfigError(f"seed {seed}: no furnishing of the apartment fits in {_ATTEMPTS} draws; choose another --seed")


def _draw(rng: np.random.Generator) -> World:
    plan = _plan(rng)
    placed: list[Placement] = []
    # The living room takes the largest room.
    largest = int(np.argmax([(x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in plan.rooms_m]))
    others = iter((1 + rng.permutation(len(FURNISH) - 1)).tolist())
    keep_free = tuple(door.swing_m(1.0) for door in plan.doors)
    for i, rectangle in enumerate(plan.rooms_m):
        furnish = FURNISH[0 if i == largest else next(others)]
        placed += furnish(rng, Room(rectangle_m=rectangle, keep_free_m=keep_free))
    x0, y0, x1, y1 = plan.rooms_m[largest]
    return World(
        objects=numbered(_thinned(rng, placed)),
        structure=apartment_structure(rng, plan.rooms_m, plan.doors),
        rooms_m=plan.rooms_m,
        middle_m=((x0 + x1) / 2, (y0 + y1) / 2),
    )


def _thinned(rng: np.random.Generator, placed: list[Placement]) -> list[Placement]:
    target = int(rng.integers(_MAX_OBJECTS - 7, _MAX_OBJECTS + 1))
    loose = [i for i, one in enumerate(placed) if one.world_from_object[2, 3] > 0.1]
    gone = rng.choice(loose, size=min(len(loose), max(0, len(placed) - target)), replace=False)
    return [one for i, one in enumerate(placed) if i not in set(gone.tolist())]


def _plan(rng: np.random.Generator) -> _Plan:
    left, right = float(rng.uniform(4.5, 5.2)), float(rng.uniform(3.6, 4.2))
    near, far = float(rng.uniform(4.1, 4.6)), float(rng.uniform(3.5, 4.0))
    if rng.random() < 0.5:
        left, right = right, left
    if rng.random() < 0.5:
        near, far = far, near
    w = _WALL_M
    xs, ys = (0.0, left, left + w, left + w + right), (0.0, near, near + w, near + w + far)
    rooms = tuple((xs[2 * i], ys[2 * j], xs[2 * i + 1], ys[2 * j + 1]) for i in (0, 1) for j in (0, 1))
    doors = [drawn_door(rng, (0.88, 1.0), axis=0, at_m=left + w / 2, span_m=(ys[2 * j], ys[2 * j + 1])) for j in (0, 1)]
    doors += [
        drawn_door(rng, (0.88, 1.0), axis=1, at_m=near + w / 2, span_m=(xs[2 * i], xs[2 * i + 1])) for i in (0, 1)
    ]
    if rng.random() < 1 / 3:
        doors.pop(int(rng.integers(4)))
    return _Plan(rooms_m=rooms, doors=tuple(doors))
