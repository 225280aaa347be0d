"""One furnished room from a seed: a laid table in the middle, a group of furniture along each wall."""

from collections.abc import Sequence

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import Model, rounded_box
from hickory_stream.worlds.scene import Placement, World, at_place, numbered
from hickory_stream.worlds.support_placement import REST_M, Wall, stood_on, walls_of
from hickory_stream.worlds.textures import Color, Texture

_ATTEMPTS = 200
_HEIGHT_M = 2.6
WALL_M = 0.1
# Coarser than on objects: the colours of walls are not evaluated.
WALL_CELL_M = 0.3
FLOORS: tuple[tuple[Color, Color], ...] = (
    ((0.62, 0.47, 0.32), (0.42, 0.30, 0.19)),
    ((0.52, 0.42, 0.33), (0.34, 0.26, 0.20)),
    ((0.66, 0.58, 0.47), (0.47, 0.40, 0.31)),
)
PAINTS: tuple[Color, ...] = ((0.86, 0.84, 0.78), (0.78, 0.82, 0.80), (0.80, 0.80, 0.84), (0.87, 0.80, 0.72))


def furnished_room(seed: int, attempt: int = 0) -> World:
    """Return room number `attempt` of a seed: 20 to 22 objects of 14 kinds, none of which intersect.

    Raises:
        ConfigError: no draw fits, which no seed has shown so far.
    """
    rng = np.random.default_rng([seed, 1, attempt])
    for _ in range(_ATTEMPTS):
        world = _draw_room(rng)
        if world is not None:
            return world
    raise ConfigError(f"seed {seed}: no furnishing of the room fits in {_ATTEMPTS} draws; choose another --seed")


def _draw_room(rng: np.random.Generator) -> World | None:
    half_x, half_y = float(rng.uniform(2.6, 2.8)), float(rng.uniform(2.3, 2.5))
    middle = (float(rng.uniform(-0.12, 0.12)), float(rng.uniform(-0.12, 0.12)))
    groups = (_sitting_group, _shelf_group, _desk_group, _box_group)
    walls = walls_of((-half_x, -half_y, half_x, half_y))
    placed = _dining_group(rng, middle)
    for i, j in enumerate(rng.permutation(len(walls))):
        placed += groups[i](rng, walls[int(j)])
    if not _all_fit(placed, half_x, half_y):
        return None
    return World(
        objects=numbered(placed),
        structure=room_structure(rng, half_x, half_y, _HEIGHT_M),
        rooms_m=((-half_x, -half_y, half_x, half_y),),
        middle_m=middle,
    )


def _all_fit(placed: Sequence[Placement], half_x: float, half_y: float) -> bool:
    for i, one in enumerate(placed):
        corners = np.concatenate([part.vertices for part in one.model.parts])
        world = corners @ one.world_from_object[:3, :3].T + one.world_from_object[:3, 3]
        if (np.abs(world[:, :2]) > (half_x - 0.005, half_y - 0.005)).any() or not one.fits(placed[:i], 0.0):
            return False
    return True


def _dining_group(rng: np.random.Generator, middle: tuple[float, float]) -> list[Placement]:
    world_from_table = at_place(*middle, REST_M, np.pi / 2 + float(rng.uniform(-0.05, 0.05)))
    table = Placement(model=furniture.table(rng), world_from_object=world_from_table)
    edge = float(table.model.bounds_m()[1, 0])
    placed = [table]
    chair_seed = int(rng.integers(2**31))
    for side, y in ((-1, -0.3), (-1, 0.3), (1, float(rng.uniform(-0.25, 0.25)))):
        # The chairs of one table are equal.
        model = furniture.chair(np.random.default_rng(chair_seed))
        out = edge + float(rng.uniform(0.14, 0.26)) + float(model.bounds_m()[0, 0])
        yaw = (0.0 if side < 0 else np.pi) + float(rng.uniform(-0.08, 0.08))
        table_from_chair = at_place(side * out, y + float(rng.uniform(-0.03, 0.03)), 0.0, yaw)
        placed.append(Placement(model=model, world_from_object=world_from_table @ table_from_chair))
    things = [small_things.bowl(rng), small_things.book_stack(rng), small_things.bottle(rng), small_things.mug(rng)]
    return placed + stood_on(rng, table, table.model.surfaces[0], things)


def _sitting_group(rng: np.random.Generator, wall: Wall) -> list[Placement]:
    side = 1 if rng.random() < 0.5 else -1
    sofa = wall.place(furniture.sofa(rng), away_m=float(rng.uniform(0.02, 0.06)), along_m=-0.2 * side)
    end = -0.2 * side + side * float(sofa.model.bounds_m()[1, 1])
    along = end + side * float(rng.uniform(0.24, 0.32))
    return [sofa, wall.place(furniture.lamp(rng), away_m=float(rng.uniform(0.06, 0.12)), along_m=along)]


def _shelf_group(rng: np.random.Generator, wall: Wall) -> list[Placement]:
    side = 1 if rng.random() < 0.5 else -1
    shelf = wall.place(furniture.shelf(rng), away_m=0.012, along_m=-0.35 * side)
    surfaces = shelf.model.surfaces
    placed = [shelf, *stood_on(rng, shelf, surfaces[3], [small_things.book_row(rng)], turn_rad=0.0)]
    placed += stood_on(rng, shelf, surfaces[2], [small_things.small_box(rng)], turn_rad=0.1)
    plant = furniture.plant(rng)
    along = -0.35 * side + side * (float(shelf.model.bounds_m()[1, 1]) + float(rng.uniform(0.45, 0.6)))
    return [*placed, wall.place(plant, away_m=0.03, along_m=along)]


def _desk_group(rng: np.random.Generator, wall: Wall) -> list[Placement]:
    side = 1 if rng.random() < 0.5 else -1
    desk = wall.place(furniture.desk(rng), away_m=float(rng.uniform(0.02, 0.05)), along_m=0.2 * side)
    surface = desk.model.surfaces[0]
    x, y = surface.center_m[0] - surface.half_m[0] + 0.12, float(rng.uniform(-0.12, 0.12))
    desk_from_monitor = at_place(x, y, surface.center_m[2] + REST_M, float(rng.uniform(-0.15, 0.15)))
    monitor = Placement(model=small_things.monitor(rng), world_from_object=desk.world_from_object @ desk_from_monitor)
    mug = stood_on(rng, desk, surface, [small_things.mug(rng)], beside=[monitor])
    along = 0.2 * side - side * (float(desk.model.bounds_m()[1, 1]) + float(rng.uniform(0.24, 0.34)))
    return [desk, monitor, *mug, wall.place(furniture.bin_(rng), away_m=float(rng.uniform(0.08, 0.2)), along_m=along)]


def _box_group(rng: np.random.Generator, wall: Wall) -> list[Placement]:
    side = 1 if rng.random() < 0.5 else -1
    lower = wall.place(small_things.box(rng), away_m=float(rng.uniform(0.04, 0.1)), along_m=0.75 * side)
    upper = stood_on(rng, lower, lower.model.surfaces[0], [small_things.small_box(rng)], turn_rad=0.3)
    beside = small_things.box(rng)
    reach = float(lower.model.bounds_m()[1, 1] + beside.bounds_m()[1, 1]) + float(rng.uniform(0.04, 0.1))
    second = wall.place(beside, away_m=float(rng.uniform(0.03, 0.1)), along_m=side * (0.75 - reach))
    turn = float(rng.uniform(-0.5, 0.5))
    chair = wall.place(furniture.chair(rng), away_m=float(rng.uniform(0.25, 0.4)), along_m=-0.75 * side, turn_rad=turn)
    return [lower, *upper, second, chair]


def room_structure(rng: np.random.Generator, half_x: float, half_y: float, height_m: float) -> tuple[Model, ...]:
    """Return floor, ceiling and four walls with skirting around +-half_x, +-half_y, in the world frame."""
    boards, joints = FLOORS[int(rng.integers(len(FLOORS)))]
    paint = PAINTS[int(rng.integers(len(PAINTS)))]
    floor = Texture(pattern="planks", first=boards, second=joints, period_m=0.14, axis=int(rng.integers(2)), grain=0.1)
    darker: Color = (paint[0] * 0.93, paint[1] * 0.93, paint[2] * 0.93)
    wall = Texture(pattern="plain", first=paint, second=darker, period_m=0.35, grain=0.05)
    white = Texture(pattern="plain", first=(0.93, 0.93, 0.92), second=(0.9, 0.9, 0.89), period_m=0.5, grain=0.03)
    size = (2 * half_x + 2 * WALL_M, 2 * half_y + 2 * WALL_M, WALL_M)
    models = [
        Model(
            kind="floor", parts=(rounded_box(size, floor, at=(0, 0, -WALL_M / 2), radius_m=0.001, cell_m=WALL_CELL_M),)
        ),
        Model(
            kind="ceiling",
            parts=(rounded_box(size, white, at=(0, 0, height_m + WALL_M / 2), radius_m=0.001, cell_m=WALL_CELL_M),),
        ),
    ]
    for sign in (-1, 1):
        models.append(wall_piece((WALL_M, size[1], height_m), (sign * (half_x + WALL_M / 2), 0.0), wall, white))
        models.append(wall_piece((size[0], WALL_M, height_m), (0.0, sign * (half_y + WALL_M / 2)), wall, white))
    return tuple(models)


def wall_piece(size: tuple[float, float, float], at: tuple[float, float], paint: Texture, skirting: Texture) -> Model:
    """Return a wall and its skirting board, which protrudes by 1 cm."""
    proud = (size[0] + 0.02, size[1], 0.07) if size[0] < size[1] else (size[0], size[1] + 0.02, 0.07)
    parts = (
        rounded_box(size, paint, at=(*at, size[2] / 2), radius_m=0.001, cell_m=WALL_CELL_M),
        rounded_box(proud, skirting, at=(*at, 0.035), radius_m=0.004, cell_m=WALL_CELL_M),
    )
    return Model(kind="wall", parts=parts)
