"""What stands in the rooms and corridors of a building, beyond the uses of rooms in an apartment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.worlds import big_things, furniture, small_things, table_things
from hickory_stream.worlds.furnishing import (
    FURNISH,
    Room,
    against_wall,
    box_group,
    desk_group,
    filled_shelf,
    lay,
)
from hickory_stream.worlds.support_placement import stood_on

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    from hickory_stream.worlds.object_models import Model
    from hickory_stream.worlds.scene import Placement

_STORED: tuple[Callable[[np.random.Generator], Model], ...] = (
    small_things.small_box,
    small_things.book_stack,
    table_things.jar,
    table_things.can,
    table_things.cereal_box,
    table_things.carton,
    table_things.pot,
    table_things.toy_car,
    table_things.squeeze_bottle,
    table_things.packet,
    small_things.bowl,
    small_things.mug,
)


def office(rng: np.random.Generator, room: Room) -> list[Placement]:
    """Return three desks with chairs, shelves, a chest and what lies about."""
    for _ in range(3):
        desk_group(rng, room)
    filled_shelf(rng, room)
    chest = against_wall(rng, room, big_things.dresser(rng), away_m=(0.01, 0.03), front_m=0.6)
    lay(rng, room, chest, [table_things.vase(rng), small_things.book_stack(rng), table_things.clock(rng)], turn_rad=0.4)
    against_wall(rng, room, furniture.plant(rng), away_m=(0.04, 0.1), front_m=0.0)
    against_wall(rng, room, furniture.bin_(rng), away_m=(0.06, 0.15), front_m=0.0)
    return room.placed


def store(rng: np.random.Generator, room: Room) -> list[Placement]:
    """Return shelves full of things along the walls, boxes and luggage."""
    for _ in range(3):
        _stocked_shelf(rng, room)
    box_group(rng, room)
    against_wall(rng, room, big_things.suitcase(rng), away_m=(0.05, 0.12), front_m=0.0)
    against_wall(rng, room, big_things.stool(rng), away_m=(0.1, 0.3), front_m=0.0)
    return room.placed


def fill_up(rng: np.random.Generator, room: Room) -> list[Placement]:
    """Stand a stocked shelf and a chest with things where a furnished room has space for them."""
    _stocked_shelf(rng, room)
    chest = against_wall(rng, room, big_things.dresser(rng), away_m=(0.01, 0.03), front_m=0.6)
    lay(rng, room, chest, [table_things.table_lamp(rng), small_things.small_box(rng), table_things.ball(rng)])
    return room.placed


def _stocked_shelf(rng: np.random.Generator, room: Room) -> None:
    shelf = against_wall(rng, room, furniture.shelf(rng), away_m=(0.012, 0.016), front_m=0.6)
    if shelf is not None:
        for board in shelf.model.surfaces[1:]:
            things = [_STORED[int(i)](rng) for i in rng.integers(len(_STORED), size=3)]
            room.placed.extend(stood_on(rng, shelf, board, things, turn_rad=0.2))


USES = (*FURNISH, office, store)


def furnish_corridor(rng: np.random.Generator, section: Room) -> list[Placement]:
    """Return what stands along a wall of a section of a corridor: a bench, a plant or a bin."""
    kind = (big_things.bench, furniture.plant, furniture.bin_)[int(rng.integers(3))]
    against_wall(rng, section, kind(rng), away_m=(0.03, 0.08), front_m=0.0)
    return section.placed
