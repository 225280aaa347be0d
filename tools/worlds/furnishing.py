"""What stands in a living room, a kitchen, a bedroom and a study."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import Model
from hickory_stream.worlds.scene import Placement, at_place
from hickory_stream.worlds.support_placement import REST_M, stood_on, walls_of
from tools.worlds import big_things, table_things

_DRAWS = 80
_APART_M = 0.05
Rectangle = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class Room:
    """A room to furnish: its rectangle, rectangles to keep free, and the objects `placed` so far."""

    rectangle_m: Rectangle
    keep_free_m: tuple[Rectangle, ...]
    placed: list[Placement] = field(default_factory=list)

    def take(self, placement: Placement, apart_m: float = _APART_M) -> bool:
        """Place an object if it lies inside the room, outside the free rectangles, and apart from the other objects."""
        lower, upper = _bounds(placement)
        x0, y0, x1, y1 = self.rectangle_m
        # The skirting stands out by a centimetre.
        if lower[0] < x0 + 0.012 or lower[1] < y0 + 0.012 or upper[0] > x1 - 0.012 or upper[1] > y1 - 0.012:
            return False
        for a0, b0, a1, b1 in self.keep_free_m:
            if lower[0] < a1 and upper[0] > a0 and lower[1] < b1 and upper[1] > b0:
                return False
        if not placement.fits(self.placed, apart_m):
            return False
        self.placed.append(placement)
        return True


def living_room(rng: np.random.Generator, room: Room) -> list[Placement]:
    """Return a sitting group before a television, a shelf, and what lies about."""
    sofa = against_wall(rng, room, furniture.sofa(rng), away_m=(0.02, 0.06), front_m=0.9)
    if sofa is not None:
        low = big_things.coffee_table(rng)
        out = _front(sofa.model) + float(rng.uniform(0.32, 0.42)) + _half(low)
        table = relative(room, sofa, low, (out, float(rng.uniform(-0.2, 0.2)), float(rng.uniform(-0.08, 0.08))))
        lay(rng, room, table, [small_things.book_stack(rng), small_things.mug(rng), small_things.bowl(rng)])
        side = 1 if rng.random() < 0.5 else -1
        along = side * (float(sofa.model.bounds_m()[1, 1]) + float(rng.uniform(0.22, 0.3)))
        relative(room, sofa, furniture.lamp(rng), (-0.15, along, 0.0))
    chest = against_wall(rng, room, big_things.dresser(rng), away_m=(0.01, 0.03), front_m=0.6)
    lay(rng, room, chest, [table_things.television(rng), table_things.vase(rng)], turn_rad=0.1)
    filled_shelf(rng, room)
    against_wall(rng, room, big_things.armchair(rng), away_m=(0.15, 0.35), front_m=0.5, turn_rad=0.5)
    against_wall(rng, room, furniture.plant(rng), away_m=(0.04, 0.1), front_m=0.0)
    basket = against_wall(rng, room, big_things.basket(rng), away_m=(0.05, 0.15), front_m=0.0)
    if basket is not None and rng.random() < 0.7:
        room.placed.extend(stood_on(rng, basket, basket.model.surfaces[0], [table_things.ball(rng)]))
    if rng.random() < 0.5:
        against_wall(rng, room, big_things.speaker(rng), away_m=(0.05, 0.12), front_m=0.0)
    return room.placed


def kitchen(rng: np.random.Generator, room: Room) -> list[Placement]:
    """Return a counter with pots, a laid table with chairs, stools and a bin."""
    counter = against_wall(rng, room, big_things.kitchen_counter(rng), away_m=(0.015, 0.02), front_m=0.75)
    ware = [table_things.kettle(rng), table_things.pot(rng), table_things.plate_stack(rng), table_things.jar(rng)]
    lay(rng, room, counter, [*ware, table_things.cereal_box(rng)][: int(rng.integers(4, 6))], turn_rad=0.6)
    table = _in_the_middle(rng, room, furniture.table(rng), 1.0)
    if table is not None:
        chair_seed, edge = int(rng.integers(2**31)), _front(table.model)
        for side, y in ((-1, -0.3), (-1, 0.3), (1, float(rng.uniform(-0.25, 0.25)))):
            model = furniture.chair(np.random.default_rng(chair_seed))
            out = side * (edge + float(rng.uniform(0.14, 0.24)) - _half(model))
            turn = (0.0 if side < 0 else np.pi) + float(rng.uniform(-0.08, 0.08))
            relative(room, table, model, (out, y, turn))
        mug_seed = int(rng.integers(2**31))
        mugs = [small_things.mug(np.random.default_rng(mug_seed)) for _ in range(2)]
        lay(rng, room, table, [small_things.bowl(rng), *mugs, small_things.bottle(rng), table_things.carton(rng)])
    against_wall(rng, room, furniture.bin_(rng), away_m=(0.06, 0.15), front_m=0.0)
    against_wall(rng, room, big_things.stool(rng), away_m=(0.1, 0.3), front_m=0.0)
    return room.placed


def bedroom(rng: np.random.Generator, room: Room) -> list[Placement]:
    """Return a bed with a stand beside it, a chest, luggage and a box."""
    bed = against_wall(rng, room, big_things.bed(rng), away_m=(0.02, 0.05), front_m=0.6)
    if bed is not None:
        side = 1 if rng.random() < 0.5 else -1
        stand = big_things.nightstand(rng)
        along = side * (float(bed.model.bounds_m()[1, 1] + stand.bounds_m()[1, 1]) + float(rng.uniform(0.06, 0.12)))
        back = float(bed.model.bounds_m()[0, 0]) + _half(stand) + 0.02
        placed = relative(room, bed, stand, (back, along, 0.0)) or relative(room, bed, stand, (back, -along, 0.0))
        lay(rng, room, placed, [table_things.table_lamp(rng), table_things.clock(rng)], turn_rad=0.2)
    chest = against_wall(rng, room, big_things.dresser(rng), away_m=(0.01, 0.03), front_m=0.6)
    lay(rng, room, chest, [table_things.vase(rng), small_things.small_box(rng)], turn_rad=0.4)
    against_wall(rng, room, big_things.suitcase(rng), away_m=(0.05, 0.12), front_m=0.0)
    bench = against_wall(rng, room, big_things.bench(rng), away_m=(0.03, 0.08), front_m=0.4)
    if bench is not None and rng.random() < 0.6:
        top = float(bench.model.bounds_m()[1, 2])
        room.placed.append(
            Placement(
                model=table_things.cushion(rng),
                world_from_object=bench.world_from_object
                @ at_place(0.0, float(rng.uniform(-0.2, 0.2)), top + REST_M, 0.0),
            )
        )
    box_group(rng, room)
    return room.placed


def study(rng: np.random.Generator, room: Room) -> list[Placement]:
    """Return a desk with its chair, a shelf, boxes and a plant."""
    desk_group(rng, room)
    filled_shelf(rng, room)
    box_group(rng, room)
    against_wall(rng, room, furniture.bin_(rng), away_m=(0.06, 0.15), front_m=0.0)
    round_ = against_wall(rng, room, big_things.side_table(rng), away_m=(0.05, 0.2), front_m=0.0)
    lay(rng, room, round_, [table_things.table_lamp(rng) if rng.random() < 0.5 else table_things.clock(rng)])
    if rng.random() < 0.6:
        against_wall(rng, room, furniture.plant(rng), away_m=(0.04, 0.1), front_m=0.0)
    return room.placed


FURNISH: tuple[Callable[[np.random.Generator, Room], list[Placement]], ...] = (living_room, kitchen, bedroom, study)
"""The uses of rooms; the first goes to the largest one."""


def desk_group(rng: np.random.Generator, room: Room) -> None:
    """Stand a desk at a wall, with a screen, things and a chair."""
    desk = against_wall(rng, room, furniture.desk(rng), away_m=(0.02, 0.05), front_m=0.9)
    if desk is not None:
        screen = small_things.monitor(rng) if rng.random() < 0.6 else table_things.laptop(rng)
        things = [screen, small_things.mug(rng), small_things.book_stack(rng)]
        lay(rng, room, desk, things, turn_rad=0.2)
        chair = big_things.office_chair(rng)
        out = _front(desk.model) + float(rng.uniform(0.2, 0.35))
        relative(room, desk, chair, (out, float(rng.uniform(-0.15, 0.15)), np.pi + float(rng.uniform(-0.5, 0.5))))


def filled_shelf(rng: np.random.Generator, room: Room) -> None:
    """Stand a shelf at a wall, with things on its boards."""
    shelf = against_wall(rng, room, furniture.shelf(rng), away_m=(0.012, 0.016), front_m=0.6)
    if shelf is None:
        return
    boards = shelf.model.surfaces
    room.placed.extend(stood_on(rng, shelf, boards[3], [small_things.book_row(rng)], turn_rad=0.0))
    room.placed.extend(
        stood_on(rng, shelf, boards[2], [small_things.small_box(rng), table_things.jar(rng)], turn_rad=0.1)
    )
    if rng.random() < 0.6:
        room.placed.extend(stood_on(rng, shelf, boards[1], [table_things.toy_car(rng)], turn_rad=0.4))


def box_group(rng: np.random.Generator, room: Room) -> None:
    """Stand a box at a wall, a smaller one on it, and another a few centimetres beside it."""
    lower = against_wall(rng, room, small_things.box(rng), away_m=(0.04, 0.1), front_m=0.0)
    if lower is None:
        return
    beside = small_things.box(rng)
    along = float(lower.model.bounds_m()[1, 1] + beside.bounds_m()[1, 1]) + float(rng.uniform(0.03, 0.08))
    side = 1 if rng.random() < 0.5 else -1
    # Closer together than other objects may be, to test their separation.
    for sign in (side, -side):
        if relative(room, lower, beside, (float(rng.uniform(-0.03, 0.03)), sign * along, 0.0), apart_m=0.02):
            break
    room.placed.extend(stood_on(rng, lower, lower.model.surfaces[0], [small_things.small_box(rng)], turn_rad=0.3))


def against_wall(
    rng: np.random.Generator, room: Room, model: Model, *, away_m: tuple[float, float], front_m: float,
    turn_rad: float = 0.0,
) -> Placement | None:  # fmt: skip
    """Place a model with its back to a wall and `front_m` of free floor before it; None if it does not fit."""
    walls = walls_of(room.rectangle_m)
    half_y = float(np.abs(model.bounds_m()[:, 1]).max())
    for _ in range(_DRAWS):
        wall = walls[int(rng.integers(len(walls)))]
        reach = max(wall.half_m - half_y - 0.02, 0.0)
        along, away = float(rng.uniform(-reach, reach)), float(rng.uniform(*away_m))
        placement = wall.place(
            model, away_m=away, along_m=along, turn_rad=float(rng.uniform(-turn_rad, turn_rad)) if turn_rad else 0.0
        )
        if _has_free_front(room, placement, front_m) and room.take(placement):
            return placement
    return None


def _has_free_front(room: Room, placement: Placement, front_m: float) -> bool:
    if front_m <= 0:
        return True
    lower, upper = placement.model.bounds_m()
    xs, ys = np.linspace(upper[0] + 0.02, upper[0] + front_m, 5), np.linspace(lower[1], upper[1], 7)
    strip = np.stack(np.meshgrid(xs, ys), axis=-1).reshape(-1, 2)
    points = strip @ placement.world_from_object[:2, :2].T + placement.world_from_object[:2, 3]
    x0, y0, x1, y1 = room.rectangle_m
    inside = (points > (x0, y0)).all(axis=1) & (points < (x1, y1)).all(axis=1)
    if not inside.all():
        return False
    for other in room.placed:
        low, high = _bounds(other)
        if ((points > low[:2]) & (points < high[:2])).all(axis=1).any():
            return False
    return True


def _in_the_middle(rng: np.random.Generator, room: Room, model: Model, spread_m: float) -> Placement | None:
    x0, y0, x1, y1 = room.rectangle_m
    for _ in range(_DRAWS):
        x, y = rng.uniform(-spread_m, spread_m, size=2) / 2 + ((x0 + x1) / 2, (y0 + y1) / 2)
        yaw = float(rng.integers(2)) * np.pi / 2 + float(rng.uniform(-0.05, 0.05))
        placement = Placement(model=model, world_from_object=at_place(float(x), float(y), REST_M, yaw))
        if placement.fits(room.placed, 0.85) and room.take(placement):
            return placement
    return None


def relative(
    room: Room, other: Placement, model: Model, at: tuple[float, float, float], apart_m: float = 0.02
) -> Placement | None:
    """Place a model on the floor at (x, y, yaw) in the frame of another; None if that place is occupied."""
    x, y, yaw = at
    placement = Placement(model=model, world_from_object=other.world_from_object @ at_place(x, y, 0.0, yaw))
    return placement if room.take(placement, apart_m) else None


def lay(
    rng: np.random.Generator, room: Room, support: Placement | None, models: Sequence[Model], turn_rad: float = np.pi
) -> None:
    if support is not None:
        room.placed.extend(stood_on(rng, support, support.model.surfaces[0], models, turn_rad=turn_rad))


def _bounds(placement: Placement) -> tuple[np.ndarray, np.ndarray]:
    vertices = np.concatenate([part.vertices for part in placement.model.parts])
    world = vertices @ placement.world_from_object[:3, :3].T + placement.world_from_object[:3, 3]
    return world.min(axis=0), world.max(axis=0)


def _front(model: Model) -> float:
    return float(model.bounds_m()[1, 0])


def _half(model: Model) -> float:
    return -float(model.bounds_m()[0, 0])
