"""The structure of an apartment: floors, walls, ceiling, doorways, and pictures."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hickory_stream.worlds.object_models import Model, rounded_box
from hickory_stream.worlds.room import FLOORS, PAINTS, WALL_CELL_M, WALL_M, wall_piece
from hickory_stream.worlds.textures import Color, Texture

ROOM_HEIGHT_M = 2.6


@dataclass(frozen=True, kw_only=True, slots=True)
class DoorWay:
    """An opening in the wall at `at_m` on an axis (0 = x, 1 = y), centred at `middle_m` on the other one."""

    axis: int
    at_m: float
    middle_m: float
    width_m: float
    height_m: float = 2.05

    def swing_m(self, depth_m: float) -> tuple[float, float, float, float]:
        """Return the rectangle (x0, y0, x1, y1) up to `depth_m` on both sides of the opening."""
        half = self.width_m / 2 + 0.05
        along, across = (self.middle_m - half, self.middle_m + half), (self.at_m - depth_m, self.at_m + depth_m)
        if self.axis == 0:
            return across[0], along[0], across[1], along[1]
        return along[0], across[0], along[1], across[1]


def drawn_door(
    rng: np.random.Generator, width_m: tuple[float, float], *, axis: int, at_m: float, span_m: tuple[float, float]
) -> DoorWay:
    """Return a doorway in the wall at `at_m` on an axis, at a random position along the wall, off its corners."""
    width = float(rng.uniform(*width_m))
    low, high = span_m[0] + 0.35 + width / 2, span_m[1] - 0.35 - width / 2
    return DoorWay(axis=axis, at_m=at_m, middle_m=float(rng.uniform(low, high)), width_m=width)


def apartment_structure(
    rng: np.random.Generator, rooms_m: Sequence[tuple[float, float, float, float]], doors: Sequence[DoorWay]
) -> tuple[Model, ...]:
    """Return floors, ceiling, walls with doorways, and pictures of a grid of two by two rooms (x0, y0, x1, y1)."""
    white = Texture(pattern="plain", first=(0.93, 0.93, 0.92), second=(0.9, 0.9, 0.89), period_m=0.5, grain=0.03)
    x0, y0, x1, y1 = (f(r[i] for r in rooms_m) for i, f in ((0, min), (1, min), (2, max), (3, max)))
    models = [floor_of(rng, room) for room in rooms_m]
    size = (x1 - x0 + 2 * WALL_M, y1 - y0 + 2 * WALL_M, WALL_M)
    middle = ((x0 + x1) / 2, (y0 + y1) / 2)
    at = (*middle, ROOM_HEIGHT_M + WALL_M / 2)
    models.append(Model(kind="ceiling", parts=(rounded_box(size, white, at=at, radius_m=0.001, cell_m=WALL_CELL_M),)))
    paint = drawn_paint(rng)
    half = WALL_M / 2
    models += [
        wall_piece((WALL_M, size[1], ROOM_HEIGHT_M), (x, middle[1]), paint, white) for x in (x0 - half, x1 + half)
    ]
    models += [
        wall_piece((size[0], WALL_M, ROOM_HEIGHT_M), (middle[0], y), paint, white) for y in (y0 - half, y1 + half)
    ]
    inner = (
        (0, min(r[2] for r in rooms_m) + WALL_M / 2, (y0, y1)),
        (1, min(r[3] for r in rooms_m) + WALL_M / 2, (x0, x1)),
    )
    for axis, at_m, span in inner:
        here = [door for door in doors if door.axis == axis]
        models += inner_wall(axis, at_m, span, here, drawn_paint(rng), white)
    models += [model for room in rooms_m for model in _pictures(rng, room)]
    return tuple(models)


def floor_of(rng: np.random.Generator, room: tuple[float, float, float, float]) -> Model:
    """Return the floor of a room, reaching half under the walls around it."""
    boards, joints = FLOORS[int(rng.integers(len(FLOORS)))]
    planks = Texture(pattern="planks", first=boards, second=joints, period_m=0.14, axis=int(rng.integers(2)), grain=0.1)
    x0, y0, x1, y1 = room
    size = (x1 - x0 + WALL_M, y1 - y0 + WALL_M, WALL_M)
    at = ((x0 + x1) / 2, (y0 + y1) / 2, -WALL_M / 2)
    return Model(kind="floor", parts=(rounded_box(size, planks, at=at, radius_m=0.0005, cell_m=WALL_CELL_M),))


def drawn_paint(rng: np.random.Generator) -> Texture:
    paint = PAINTS[int(rng.integers(len(PAINTS)))]
    darker: Color = (paint[0] * 0.93, paint[1] * 0.93, paint[2] * 0.93)
    return Texture(pattern="plain", first=paint, second=darker, period_m=0.35, grain=0.05)


def inner_wall(
    axis: int, at_m: float, span: tuple[float, float], doors: Sequence[DoorWay], paint: Texture, trim: Texture
) -> list[Model]:
    """Return the pieces of a wall between its door ways, and over each a lintel with a frame around the opening."""

    def turned(along: float, across: float) -> tuple[float, float]:
        return (across, along) if axis == 0 else (along, across)

    models, start = [], span[0]
    for door in sorted(doors, key=lambda door: door.middle_m):
        low, high = door.middle_m - door.width_m / 2, door.middle_m + door.width_m / 2
        models.append(
            wall_piece((*turned(low - start, WALL_M), ROOM_HEIGHT_M), turned((start + low) / 2, at_m), paint, trim)
        )
        rest = ROOM_HEIGHT_M - door.height_m
        lintel = rounded_box(
            (*turned(door.width_m, WALL_M), rest), paint, at=(*turned(door.middle_m, at_m), door.height_m + rest / 2),
            radius_m=0.001, cell_m=WALL_CELL_M,
        )  # fmt: skip
        jambs = [
            rounded_box(
                (*turned(0.05, WALL_M + 0.03), door.height_m),
                trim,
                at=(*turned(edge, at_m), door.height_m / 2),
                radius_m=0.004,
                cell_m=WALL_CELL_M,
            )
            for edge in (low + 0.01, high - 0.01)
        ]
        head = rounded_box(
            (*turned(door.width_m + 0.05, WALL_M + 0.03), 0.05), trim, at=(*turned(door.middle_m, at_m), door.height_m),
            radius_m=0.004, cell_m=WALL_CELL_M,
        )  # fmt: skip
        models.append(Model(kind="door_way", parts=(lintel, *jambs, head)))
        start = high
    models.append(
        wall_piece((*turned(span[1] - start, WALL_M), ROOM_HEIGHT_M), turned((start + span[1]) / 2, at_m), paint, trim)
    )
    return models


def _pictures(rng: np.random.Generator, room: tuple[float, float, float, float]) -> list[Model]:
    # Pictures are flat and count as structure.
    x0, y0, x1, y1 = room
    models = []
    for axis in (0, 1):
        if rng.random() < 0.5:
            continue
        width, height = float(rng.uniform(0.4, 0.7)), float(rng.uniform(0.3, 0.45))
        first, second = PAINTS[int(rng.integers(len(PAINTS)))], FLOORS[int(rng.integers(len(FLOORS)))][1]
        canvas = Texture(pattern="checker", first=first, second=second, period_m=0.11, grain=0.2)
        z = float(rng.uniform(1.9, 2.05))
        if axis == 0:
            edge = x0 if x0 <= 0.0 else x1
            inward = 0.011 if x0 <= 0.0 else -0.011
            at = (edge + inward, float(rng.uniform(y0 + 0.6, y1 - 0.6)), z)
            size = (0.02, width, height)
        else:
            edge = y0 if y0 <= 0.0 else y1
            inward = 0.011 if y0 <= 0.0 else -0.011
            at = (float(rng.uniform(x0 + 0.6, x1 - 0.6)), edge + inward, z)
            size = (width, 0.02, height)
        models.append(Model(kind="picture", parts=(rounded_box(size, canvas, at=at, radius_m=0.004),)))
    return models
