"""Units that stand flush in rows, such as cupboards: one function per recipe, its back at -x."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.object_models import Model
from tools.worlds.clutter.draws import about_y, chance, count, log_uniform, one_of, uniform
from tools.worlds.clutter.objects.fittings import fronts, level_top
from tools.worlds.clutter.objects.solids import block, cylinder, grounded, torus

if TYPE_CHECKING:
    from collections.abc import Callable

    from tools.worlds.clutter.objects.materials import Skin


def appliance(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a flush body with one or two doors, a panel, a handle, at times a round window; back at -x."""
    depth, width, height = uniform(rng, 0.45, 0.75), uniform(rng, 0.4, 0.95), log_uniform(rng, 0.6, 2.0)
    body, face = skin(rng), skin(rng)
    plain = body if chance(rng, 0.7) else face
    parts = [block((depth, width, height), body, at=(0, 0, height / 2), radius_m=uniform(rng, 0.002, 0.02))]
    split = uniform(rng, 0.3, 0.75) * height if height > 1.2 else height * uniform(rng, 0.8, 0.92)
    for z0, z1 in ((0.05, split), (split, height - 0.01)):
        at = (depth / 2 + 0.008, 0, (z0 + z1) / 2)
        parts.append(block((0.02, width - 0.008, z1 - z0 - 0.008), plain, at=at, radius_m=0.006))
    if height < 1.2 and chance(rng, 0.5):
        round_, middle = min(uniform(rng, 0.25, 0.4) * width, 0.4 * split), (depth / 2 + 0.02, 0.0, split * 0.55)
        parts.append(torus(round_, 0.025, skin(rng)).moved(middle, about_y(np.pi / 2)))
        parts.append(
            cylinder(round_, 0.012, face, segments=30).moved((middle[0] - 0.008, 0, middle[2]), about_y(np.pi / 2))
        )
    else:
        grip = (depth / 2 + 0.045, one_of(rng, (-1, 1)) * (width / 2 - 0.06), split - 0.25)
        parts.append(block((0.02, 0.025, min(0.4, 0.4 * height)), face, at=grip))
    surfaces = (level_top(depth, width, height),) if height < 1.5 else ()
    return Model(kind="appliance", parts=tuple(parts), surfaces=surfaces)


def kitchen_unit(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a unit of a fitted kitchen: a body with doors or drawers under its own piece of worktop."""
    width, top = uniform(rng, 0.3, 1.0), uniform(rng, 0.02, 0.05)
    size = (0.6, width, 0.88)
    parts = [
        block((size[0] - 0.04, width, size[2] - top), skin(rng), at=(0, 0, (size[2] - top) / 2), radius_m=0.002),
        block((size[0], width, top), skin(rng), at=(0, 0, size[2] - top / 2), radius_m=0.003),
    ]
    parts += fronts(rng, (size[0] - 0.04, width, size[2] - top), 0.1, (1, count(rng, 1, 4)), skin(rng), skin(rng))
    return Model(kind="kitchen_unit", parts=tuple(parts), surfaces=(level_top(size[0], width, size[2]),))


def tower(rng: np.random.Generator, skin: Skin) -> Model:
    """Return an upright case with a recessed front: cabinets of machines, vending machines, stoves."""
    depth, width, height = uniform(rng, 0.4, 0.7), uniform(rng, 0.35, 0.8), uniform(rng, 0.8, 2.0)
    case, rim = skin(rng), uniform(rng, 0.02, 0.06)
    parts = [block((depth - 0.05, width, height), case, at=(-0.025, 0, height / 2))]
    parts += [
        block((0.06, rim, height), case, at=(depth / 2 - 0.03, s * (width - rim) / 2, height / 2)) for s in (-1, 1)
    ]
    parts += [block((0.06, width, rim), case, at=(depth / 2 - 0.03, 0, z)) for z in (rim / 2, height - rim / 2)]
    parts.append(block((0.02, width - 2 * rim, height * 0.5), skin(rng), at=(depth / 2 - 0.045, 0, height * 0.6)))
    surfaces = (level_top(depth, width, height),) if height < 1.5 else ()
    return grounded("tower", parts) if not surfaces else Model(kind="tower", parts=tuple(parts), surfaces=surfaces)


def locker(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a tall narrow body with slotted doors."""
    depth, width, height = uniform(rng, 0.35, 0.6), uniform(rng, 0.25, 0.6), uniform(rng, 1.0, 2.0)
    metal, door, dark = skin(rng), skin(rng), skin(rng)
    parts = [block((depth, width, height), metal, at=(0, 0, height / 2), radius_m=0.002)]
    doors = count(rng, 1, 4)
    for i in range(doors):
        high, z = height / doors, (i + 0.5) * height / doors
        parts.append(block((0.014, width - 0.02, high - 0.02), door, at=(depth / 2 + 0.004, 0, z)))
        parts += [
            block((0.004, 0.5 * width, 0.01), dark, at=(depth / 2 + 0.012, 0, z + high * 0.3 + k * 0.025))
            for k in range(3)
        ]
        parts.append(block((0.02, 0.02, 0.07), dark, at=(depth / 2 + 0.015, 0.4 * width, z)))
    surfaces = (level_top(depth, width, height),) if height < 1.5 else ()
    return Model(kind="locker", parts=tuple(parts), surfaces=surfaces)


UNITS: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f
    for f in (
        appliance,
        kitchen_unit,
        tower,
        locker,
    )
}
"""The recipes of units by name."""
