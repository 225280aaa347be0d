"""A building from a seed: one to eight storeys of furnished rooms along a corridor, joined by a stairwell."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import Model, rounded_box
from hickory_stream.worlds.room import WALL_M, wall_piece
from hickory_stream.worlds.scene import Placement, World, at_place, numbered
from hickory_stream.worlds.support_placement import stood_on
from hickory_stream.worlds.textures import Texture
from tools.worlds import big_things, table_things
from tools.worlds.building.plan import STOREY_M, Outline, Stairwell, StoreyPlan, drawn_outline, drawn_plan
from tools.worlds.furnishing import FURNISH, Rectangle, Room, against_wall, box_group, desk_group, filled_shelf, lay
from tools.worlds.routes import joins_rooms
from tools.worlds.structure import ROOM_HEIGHT_M, drawn_paint, floor_of, inner_wall

_CELL_M = 0.3
_PICTURE_SHARE = 0.6
_WHITE = Texture(pattern="plain", first=(0.93, 0.93, 0.92), second=(0.9, 0.9, 0.89), period_m=0.5, grain=0.03)


def storey_structure(rng: np.random.Generator, plan: StoreyPlan) -> tuple[Model, ...]:
    """Return the structure of a storey with its floor at z = 0, without the stairwell."""
    outline = plan.outline
    width, length = outline.width_m, outline.length_m
    low, high = -WALL_M - outline.depths_m[0], width + WALL_M + outline.depths_m[1]
    half = WALL_M / 2
    corridor = (0.0, 0.0, length, width)
    models = [floor_of(rng, room) for room in (*plan.rooms_m, corridor)]
    size = (length + 2 * WALL_M, high - low + 2 * WALL_M, WALL_M)
    at = (length / 2, (low + high) / 2, ROOM_HEIGHT_M + half)
    models.append(Model(kind="ceiling", parts=(rounded_box(size, _WHITE, at=at, radius_m=0.001, cell_m=_CELL_M),)))
    paint = drawn_paint(rng)
    outer = [((length + 2 * WALL_M, WALL_M, ROOM_HEIGHT_M), (length / 2, y)) for y in (low - half, high + half)]
    outer.append(((WALL_M, high - low, ROOM_HEIGHT_M), (-half, (low + high) / 2)))
    # Beside the door to the stairs, the corridor's end is a wall with a door way.
    for y0, y1 in ((low, 0.0), (width, high)):
        outer.append(((WALL_M, y1 - y0, ROOM_HEIGHT_M), (length + half, (y0 + y1) / 2)))
    models += [wall_piece(one, where, paint, _WHITE) for one, where in outer]
    stairs = plan.stairs_door
    models += inner_wall(0, stairs.at_m, (0.0, width), [stairs], paint, _WHITE)
    for y in (-half, width + half):
        doors = [door for door in plan.doors if door.axis == 1 and door.at_m == y]
        models += inner_wall(1, y, (0.0, length), doors, drawn_paint(rng), _WHITE)
    for room, side in zip(plan.rooms_m, plan.sides, strict=True):
        if room[0] > 0.0:
            x = room[0] - half
            doors = [
                door for door in plan.doors if door.axis == 0 and door.at_m == x and (room[1] < door.middle_m < room[3])
            ]
            models += inner_wall(0, x, (room[1], room[3]), doors, drawn_paint(rng), _WHITE)
        if rng.random() < _PICTURE_SHARE:
            models.append(_picture(rng, room, side))
    return tuple(models)


def _picture(rng: np.random.Generator, room: Rectangle, side: int) -> Model:
    # Pictures are flat and count as structure.
    x0, y0, x1, y1 = room
    width, height = float(rng.uniform(0.4, 0.7)), float(rng.uniform(0.3, 0.45))
    first, second = (tuple(float(v) for v in rng.uniform(0.3, 0.9, size=3)) for _ in range(2))
    canvas = Texture(
        pattern="checker", first=(first[0], first[1], first[2]), second=(second[0], second[1], second[2]),
        period_m=0.11, grain=0.2,
    )  # fmt: skip
    y = y0 + 0.011 if side == 0 else y1 - 0.011
    at = (float(rng.uniform(x0 + 0.6, x1 - 0.6)), y, float(rng.uniform(1.9, 2.05)))
    return Model(kind="picture", parts=(rounded_box((width, 0.02, height), canvas, at=at, radius_m=0.004),))


_STORED: tuple[Callable[[np.random.Generator], Model], ...] = (
    small_things.small_box, small_things.book_stack, table_things.jar, table_things.can, table_things.cereal_box,
    table_things.carton, table_things.pot, table_things.toy_car, table_things.squeeze_bottle, table_things.packet,
    small_things.bowl, small_things.mug,
)  # fmt: skip


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


_ATTEMPTS = 20
_CLEARANCE_M = 0.34
MOST_FLOORS, MOST_ROOMS = 8, 40
_LEAST_A_FLOOR = 2
# Before a door, so much floor stays free.
_SWING_M = 0.9


@dataclass(frozen=True, kw_only=True, slots=True)
class BuildingSize:
    """How large a building is: `floors` storeys share `rooms` as evenly as they can."""

    floors: int = 2
    rooms: int = 12

    def __post_init__(self) -> None:
        if not (1 <= self.floors <= MOST_FLOORS and _LEAST_A_FLOOR * self.floors <= self.rooms <= MOST_ROOMS):
            raise ConfigError(
                f"a building of {self.floors} floors and {self.rooms} rooms; expected 1 to {MOST_FLOORS} floors, "
                f"at least {_LEAST_A_FLOOR} rooms a floor, and at most {MOST_ROOMS} rooms"
            )

    def rooms_of(self, floor: int) -> int:
        return self.rooms // self.floors + (floor < self.rooms % self.floors)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Storey:
    """One storey: its `world` with the floor at z = 0, the rooms of the plan first, and its height `floor_m`."""

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
    # Raises ConfigError: no draw fits, which no seed has shown so far.
    outline = drawn_outline(np.random.default_rng([seed, 17, attempt]), size.rooms_of(0))
    storeys = tuple(_storey(seed, attempt, floor, outline, size.rooms_of(floor)) for floor in range(size.floors))
    stairwell = Stairwell.beyond(outline)
    rng = np.random.default_rng([seed, 18, attempt])
    return Building(
        storeys=storeys, stairwell=stairwell, world=_joined(storeys, stairwell, stairwell.structure(rng, size.floors))
    )


def _storey(seed: int, attempt: int, floor: int, outline: Outline, rooms: int) -> Storey:
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
    placed = [
        Placement(model=item.model, world_from_object=at_place(0.0, 0.0, storey.floor_m, 0.0) @ item.world_from_object)
        for storey in storeys
        for item in storey.world.objects
    ]
    structure = [_raised(model, storey.floor_m) for storey in storeys for model in storey.world.structure]
    rooms = [(room, storey.floor_m) for storey in storeys for room in (*storey.world.rooms_m, stairwell.rectangle_m)]
    return World(
        objects=numbered(placed), structure=(*structure, *stairs), rooms_m=tuple(room for room, _ in rooms),
        floors_m=tuple(floor_m for _, floor_m in rooms), middle_m=storeys[0].world.middle_m,
    )  # fmt: skip


def _raised(model: Model, by_m: float) -> Model:
    return replace(model, parts=tuple(part.moved((0.0, 0.0, by_m)) for part in model.parts)) if by_m else model
