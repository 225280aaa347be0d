"""Parts that many kinds of furniture have: legs, fronts with handles, tops."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.worlds.object_models import Part, Surface
from tools.worlds.clutter.draws import chance, uniform
from tools.worlds.clutter.objects.solids import block, regular, sweep

if TYPE_CHECKING:
    import numpy as np

    from hickory_stream.worlds.textures import Texture

FREE_M = 1.0
"""The height above an open top that things may take."""


def four_legs(
    rng: np.random.Generator, at: tuple[float, float], height: float, thick: float, lean: float, texture: Texture
) -> list[Part]:
    """Return four legs, square or round, that lean outwards by `lean` metres a metre."""
    is_round, parts = chance(rng, 0.5), []
    outline = regular(12 if is_round else 4, thick * (0.5 if is_round else 0.7))
    for sx in (-1, 1):
        for sy in (-1, 1):
            foot = (sx * (at[0] + lean * height), sy * (at[1] + lean * height), 0.0)
            parts.append(sweep(outline, [foot, (sx * at[0], sy * at[1], height)], texture))
    low = min(float(part.vertices[:, 2].min()) for part in parts)
    return [part.moved((0, 0, -low)) for part in parts]


def level_top(depth: float, length: float, height: float, x: float = 0.0, headroom: float = FREE_M) -> Surface:
    """Return a surface a centimetre within the border of a board."""
    return Surface(center_m=(x, 0.0, height), half_m=(depth / 2 - 0.01, length / 2 - 0.01), headroom_m=headroom)


def fronts(
    rng: np.random.Generator,
    size: tuple[float, float, float],
    plinth: float,
    fields: tuple[int, int],
    front: Texture,
    knob: Texture,
) -> list[Part]:
    """Return a grid of panels on the front of a body with joints between them, and a handle on each."""
    depth, width, height = size
    columns, rows = fields
    dy, dz, parts = width / columns, (height - plinth) / rows, []
    joint, proud, is_bar = uniform(rng, 0.003, 0.02), uniform(rng, 0.004, 0.02), chance(rng, 0.5)
    for i in range(columns):
        for j in range(rows):
            y, z = (i + 0.5) * dy - width / 2, plinth + (j + 0.5) * dz
            parts.append(block((proud, dy - joint, dz - joint), front, at=(depth / 2 + proud / 2 - 0.001, y, z)))
            x = depth / 2 + proud + 0.008
            if is_bar:
                parts.append(block((0.02, min(0.12, dy * 0.4), 0.012), knob, at=(x, y, z + 0.3 * dz)))
            else:
                parts.append(block((0.02, 0.025, 0.025), knob, at=(x, y + 0.35 * dy, z)))
    return parts
