"""Floor, walls and ceiling: what is no object."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.evaluation.worlds.parts import Model, rounded_box
from hickory_stream.evaluation.worlds.textures import Texture

if TYPE_CHECKING:
    import numpy as np

    from hickory_stream.evaluation.worlds.textures import Color

_THICK_M = 0.1
# Coarser than on objects: nobody measures the colours of a wall.
_CELL_M = 0.3
_FLOORS: tuple[tuple[Color, Color], ...] = (
    ((0.62, 0.47, 0.32), (0.42, 0.30, 0.19)),
    ((0.52, 0.42, 0.33), (0.34, 0.26, 0.20)),
    ((0.66, 0.58, 0.47), (0.47, 0.40, 0.31)),
)
_WALLS: tuple[Color, ...] = ((0.86, 0.84, 0.78), (0.78, 0.82, 0.80), (0.80, 0.80, 0.84), (0.87, 0.80, 0.72))


def room_structure(rng: np.random.Generator, half_x: float, half_y: float, height_m: float) -> tuple[Model, ...]:
    """Return floor, ceiling and four walls with skirting around +-half_x, +-half_y, in the world frame."""
    boards, joints = _FLOORS[int(rng.integers(len(_FLOORS)))]
    paint = _WALLS[int(rng.integers(len(_WALLS)))]
    floor = Texture(pattern="planks", first=boards, second=joints, period_m=0.14, axis=int(rng.integers(2)), grain=0.1)
    darker: Color = (paint[0] * 0.93, paint[1] * 0.93, paint[2] * 0.93)
    wall = Texture(pattern="plain", first=paint, second=darker, period_m=0.35, grain=0.05)
    white = Texture(pattern="plain", first=(0.93, 0.93, 0.92), second=(0.9, 0.9, 0.89), period_m=0.5, grain=0.03)
    size = (2 * half_x + 2 * _THICK_M, 2 * half_y + 2 * _THICK_M, _THICK_M)
    models = [
        Model(
            kind="floor", parts=(rounded_box(size, floor, at=(0, 0, -_THICK_M / 2), radius_m=0.001, cell_m=_CELL_M),)
        ),
        Model(
            kind="ceiling",
            parts=(rounded_box(size, white, at=(0, 0, height_m + _THICK_M / 2), radius_m=0.001, cell_m=_CELL_M),),
        ),
    ]
    for sign in (-1, 1):
        models.append(_wall((_THICK_M, size[1], height_m), (sign * (half_x + _THICK_M / 2), 0.0), wall, white))
        models.append(_wall((size[0], _THICK_M, height_m), (0.0, sign * (half_y + _THICK_M / 2)), wall, white))
    return tuple(models)


def _wall(size: tuple[float, float, float], at: tuple[float, float], paint: Texture, skirting: Texture) -> Model:
    """Return a wall and its skirting board, which stands 1 cm proud of it."""
    proud = (size[0] + 0.02, size[1], 0.07) if size[0] < size[1] else (size[0], size[1] + 0.02, 0.07)
    parts = (
        rounded_box(size, paint, at=(*at, size[2] / 2), radius_m=0.001, cell_m=_CELL_M),
        rounded_box(proud, skirting, at=(*at, 0.035), radius_m=0.004, cell_m=_CELL_M),
    )
    return Model(kind="wall", parts=parts)
