"""The same world on another day: things were moved, removed, added and exchanged."""
# A moved object keeps its id, a new one gets one that no earlier day had.

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.worlds import small_things
from hickory_stream.worlds.object_models import Model
from hickory_stream.worlds.scene import Placement, World, WorldObject, at_place
from hickory_stream.worlds.support_placement import REST_M, stood_on
from tools.worlds import big_things, table_things

CHANGES_A_DAY = 8
_ATTEMPTS = 40
_DRAWS = 60
_APART_M, _GAP_M = 0.08, 0.04
_SHIFT_M = 0.4
# What a day brings, in turn.
_TURNS = ("move", "remove", "add", "move", "exchange", "move", "remove", "add")
_SMALL = (
    small_things.mug, small_things.bowl, small_things.book_stack, table_things.vase, table_things.kettle,
    table_things.jar, table_things.cereal_box,
)  # fmt: skip
_LARGE = (big_things.basket, big_things.suitcase, big_things.stool)


def world_of_day(world: World, seed: int, day: int, is_walkable: Callable[[World], bool]) -> World:
    """Return the world after a number of days, each with up to eight changes, and a third of the objects at most."""
    # Raises ConfigError: no draw of a day leaves the world walkable.
    for today in range(1, day + 1):
        rng = np.random.default_rng([seed, 21, today])
        first_id = 1000 * today
        drawn = (_changed(world, rng, first_id) for _ in range(_ATTEMPTS))
        found = next((one for one in drawn if is_walkable(one)), None)
        if found is None:
            raise ConfigError(f"seed {seed}: no draw of day {today} leaves room to walk; choose another --seed")
        world = found
    return world


def _changed(world: World, rng: np.random.Generator, first_id: int) -> World:
    objects = list(world.objects)
    touched: set[int] = set()
    for n, turn in enumerate(_TURNS[: max(1, min(CHANGES_A_DAY, len(objects) // 3))]):
        free = [item for item in objects if item.id not in touched and not _carries(item, objects)]
        one = free[int(rng.integers(len(free)))] if free else None
        new_id = first_id + n
        if turn == "add":
            placed = _added(world, rng, objects)
            done = None if placed is None else _as_object(placed, new_id)
        elif one is None:
            continue
        elif turn == "remove":
            objects.remove(one)
            touched.add(one.id)
            continue
        elif turn == "move":
            placed = _elsewhere(world, rng, one.model, [item for item in objects if item is not one], one)
            done = None if placed is None else replace(one, world_from_object=placed.world_from_object)
        else:
            placed = _in_place_of(rng, one, [item for item in objects if item is not one])
            done = None if placed is None else _as_object(placed, new_id)
        if done is None:
            continue
        if one is not None and turn != "add":
            objects.remove(one)
            touched.add(one.id)
        touched.add(done.id)
        objects.append(done)
    return replace(world, objects=tuple(sorted(objects, key=lambda item: item.id)))


def _added(world: World, rng: np.random.Generator, objects: Sequence[WorldObject]) -> Placement | None:
    recipes = _LARGE if rng.random() < 0.4 else _SMALL
    return _elsewhere(world, rng, recipes[int(rng.integers(len(recipes)))](rng), objects, None)


def _elsewhere(
    world: World, rng: np.random.Generator, model: Model, others: Sequence[WorldObject], before: WorldObject | None
) -> Placement | None:
    # On furniture if it is small, else on the floor; away from its place before.
    placements = [Placement(model=item.model, world_from_object=item.world_from_object) for item in others]
    lower, upper = model.bounds_m()
    if float((upper - lower).max()) < 0.4:
        supports = [(one, surface) for one in placements for surface in one.model.surfaces]
        for k in rng.permutation(len(supports))[:8]:
            support, surface = supports[int(k)]
            beside = [one for one in placements if one is not support]
            found = stood_on(rng, support, surface, [model], beside=beside, gap_m=_GAP_M)
            if found and _is_away(found[0], before):
                return found[0]
    for _ in range(_DRAWS):
        x0, y0, x1, y1 = world.rooms_m[int(rng.integers(len(world.rooms_m)))]
        reach = float(np.linalg.norm(np.maximum(np.abs(lower[:2]), np.abs(upper[:2])))) + _APART_M
        if x1 - x0 <= 2 * reach or y1 - y0 <= 2 * reach:
            continue
        x, y = float(rng.uniform(x0 + reach, x1 - reach)), float(rng.uniform(y0 + reach, y1 - reach))
        one = Placement(model=model, world_from_object=at_place(x, y, REST_M, float(rng.uniform(-np.pi, np.pi))))
        if _is_away(one, before) and one.fits(placements, _APART_M):
            return one
    return None


def _in_place_of(rng: np.random.Generator, one: WorldObject, others: Sequence[WorldObject]) -> Placement | None:
    placements = [Placement(model=item.model, world_from_object=item.world_from_object) for item in others]
    lower, upper = one.model.bounds_m()
    recipes = _SMALL if float((upper - lower).max()) < 0.4 else _LARGE
    for _ in range(10):
        model = recipes[int(rng.integers(len(recipes)))](rng)
        placed = Placement(model=model, world_from_object=one.world_from_object)
        if model.kind != one.model.kind and placed.fits(placements, 0.01):
            return placed
    return None


def _is_away(placed: Placement, before: WorldObject | None) -> bool:
    if before is None:
        return True
    shift = placed.world_from_object[:3, 3] - before.world_from_object[:3, 3]
    return float(np.linalg.norm(shift)) > _SHIFT_M


def _as_object(placed: Placement, object_id: int) -> WorldObject:
    return WorldObject(id=object_id, model=placed.model, world_from_object=placed.world_from_object)


def _carries(item: WorldObject, objects: Sequence[WorldObject]) -> bool:
    lower, upper = item.model.bounds_m()
    for other in objects:
        local = np.linalg.solve(item.world_from_object, other.world_from_object)[:3, 3]
        if other is not item and (local[:2] > lower[:2]).all() and (local[:2] < upper[:2]).all() and local[2] > 0.01:
            return True
    return False
