"""A building from a seed: one to eight storeys of rooms along a corridor, joined by a stairwell."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.worlds.building.plan import drawn_outline, drawn_plan
from hickory_stream.worlds.building.stairwell import STOREY_M, Stairwell
from hickory_stream.worlds.building.structure import storey_structure
from hickory_stream.worlds.building.uses import USES, fill_up, furnish_corridor
from hickory_stream.worlds.clearance import joins_rooms
from hickory_stream.worlds.furnishing import Room
from hickory_stream.worlds.scene import Placement, World, at_place, numbered

if TYPE_CHECKING:
    from hickory_stream.worlds.building.plan import Outline, StoreyPlan
    from hickory_stream.worlds.object_models import Model

_ATTEMPTS = 20
_CLEARANCE_M = 0.34
MOST_FLOORS, MOST_ROOMS = 8, 40
_LEAST_A_FLOOR = 2
# Before a door, so much floor stays free.
_SWING_M = 0.9


@dataclass(frozen=True, kw_only=True, slots=True)
class BuildingSize:
    """How large a building is: `floors` storeys, and `rooms` in all of them, as evenly as they can be shared out."""

    floors: int = 2
    rooms: int = 12

    def __post_init__(self) -> None:
        if not (1 <= self.floors <= MOST_FLOORS and _LEAST_A_FLOOR * self.floors <= self.rooms <= MOST_ROOMS):
            raise ConfigError(
                f"a building of {self.floors} floors and {self.rooms} rooms; expected 1 to {MOST_FLOORS} floors, "
                f"at least {_LEAST_A_FLOOR} rooms a floor, and at most {MOST_ROOMS} rooms"
            )

    def rooms_of(self, floor: int) -> int:
        """Return how many rooms a floor has."""
        return self.rooms // self.floors + (floor < self.rooms % self.floors)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Storey:
    """One storey: its `world` with the floor at z = 0, and its height `floor_m` in the building.

    The first of the world's rooms are those of the plan; sections of the corridor follow.
    """

    world: World
    plan: StoreyPlan
    floor_m: float


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Building:
    """All storeys, the stairwell that joins them, and the `world` of everything."""

    storeys: tuple[Storey, ...]
    stairwell: Stairwell
    world: World


def building(seed: int, size: BuildingSize, attempt: int = 0) -> Building:
    """Return building number `attempt` of a seed.

    Raises:
        ConfigError: no furnishing of a storey leaves a way into all of its rooms; no seed has shown this so far.
    """
    outline = drawn_outline(np.random.default_rng([seed, 17, attempt]), size.rooms_of(0))
    storeys = tuple(_storey(seed, attempt, floor, outline, size.rooms_of(floor)) for floor in range(size.floors))
    stairwell = Stairwell.beyond(outline)
    rng = np.random.default_rng([seed, 18, attempt])
    return Building(
        storeys=storeys, stairwell=stairwell, world=_joined(storeys, stairwell, stairwell.structure(rng, size.floors))
    )


def _storey(seed: int, attempt: int, floor: int, outline: Outline, rooms: int) -> Storey:
    """Return the first furnishing of a storey that one can walk through; each storey draws for itself."""
    rng = np.random.default_rng([seed, 19, attempt, floor])
    for _ in range(_ATTEMPTS):
        plan = drawn_plan(rng, outline, rooms)
        world = _furnished(rng, plan)
        if joins_rooms(world, _CLEARANCE_M):
            return Storey(world=world, plan=plan, floor_m=floor * STOREY_M)
    raise ConfigError(
        f"seed {seed}: no furnishing of floor {floor} leaves a way through it in {_ATTEMPTS} draws; "
        "choose another --seed"
    )


def _furnished(rng: np.random.Generator, plan: StoreyPlan) -> World:
    keep_free = tuple(door.swing_m(_SWING_M) for door in plan.doors)
    # The uses come in turn, from a drawn one on, so that each floor has some of all of them.
    uses = rng.permutation(len(USES))
    placed: list[Placement] = []
    for i, rectangle in enumerate(plan.rooms_m):
        room = Room(rectangle_m=rectangle, keep_free_m=keep_free)
        USES[int(uses[i % len(USES)])](rng, room)
        placed += fill_up(rng, room)
    for section in plan.sections_m:
        placed += furnish_corridor(rng, Room(rectangle_m=section, keep_free_m=keep_free))
    length, width = plan.outline.length_m, plan.outline.width_m
    return World(
        objects=numbered(placed),
        structure=storey_structure(rng, plan),
        rooms_m=(*plan.rooms_m, *plan.sections_m),
        middle_m=(length / 2, width / 2),
    )


def _joined(storeys: tuple[Storey, ...], stairwell: Stairwell, stairs: tuple[Model, ...]) -> World:
    """Return the world of all storeys, each raised to its height, with the stairwell as a room of each of them."""
    placed = [
        Placement(model=item.model, world_from_object=at_place(0.0, 0.0, storey.floor_m, 0.0) @ item.world_from_object)
        for storey in storeys
        for item in storey.world.objects
    ]
    structure = [_raised(model, storey.floor_m) for storey in storeys for model in storey.world.structure]
    rooms = [(room, storey.floor_m) for storey in storeys for room in (*storey.world.rooms_m, stairwell.rectangle_m)]
    return World(
        objects=numbered(placed),
        structure=(*structure, *stairs),
        rooms_m=tuple(room for room, _ in rooms),
        floors_m=tuple(floor_m for _, floor_m in rooms),
        middle_m=storeys[0].world.middle_m,
    )


def _raised(model: Model, by_m: float) -> Model:
    return replace(model, parts=tuple(part.moved((0.0, 0.0, by_m)) for part in model.parts)) if by_m else model
