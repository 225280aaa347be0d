"""Floors, walls, door ways and ceiling of a storey, and the pictures on its outer walls; its floor is at z = 0."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.worlds.object_models import Model, rounded_box
from hickory_stream.worlds.structure import (
    ROOM_HEIGHT_M,
    WALL_M,
    drawn_paint,
    floor_of,
    inner_wall,
    wall_piece,
)
from hickory_stream.worlds.textures import Texture

if TYPE_CHECKING:
    import numpy as np

    from hickory_stream.worlds.building.plan import StoreyPlan
    from hickory_stream.worlds.furnishing import Rectangle

_CELL_M = 0.3
_PICTURE_SHARE = 0.6
_WHITE = Texture(pattern="plain", first=(0.93, 0.93, 0.92), second=(0.9, 0.9, 0.89), period_m=0.5, grain=0.03)


def storey_structure(rng: np.random.Generator, plan: StoreyPlan) -> tuple[Model, ...]:
    """Return the structure of a storey, without that of the stairwell."""
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
                door for door in plan.doors if door.axis == 0 and door.at_m == x and _is_within(door.middle_m, room)
            ]
            models += inner_wall(0, x, (room[1], room[3]), doors, drawn_paint(rng), _WHITE)
        if rng.random() < _PICTURE_SHARE:
            models.append(_picture(rng, room, side))
    return tuple(models)


def _is_within(y: float, room: Rectangle) -> bool:
    return room[1] < y < room[3]


def _picture(rng: np.random.Generator, room: Rectangle, side: int) -> Model:
    """Return a picture high on the outer wall of a room; it is flat and counts as structure."""
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
