"""Chairs of random make: one function per recipe; one looks along +x when sitting on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.object_models import Model, Part, tube
from tools.worlds.clutter.draws import about_y, chance, count, one_of, uniform
from tools.worlds.clutter.objects.fittings import four_legs
from tools.worlds.clutter.objects.solids import block, cylinder, grounded, regular, sheet, superellipsoid, sweep

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.worlds.textures import Texture
    from tools.worlds.clutter.objects.materials import Skin


def chair(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a chair or a bar stool: legs, sled or star foot; a back of boards, bars or one bent sheet, or none."""
    width, depth, seat = uniform(rng, 0.36, 0.55), uniform(rng, 0.36, 0.52), uniform(rng, 0.38, 0.78)
    frame, cover, thick = skin(rng), skin(rng), uniform(rng, 0.015, 0.09)
    parts = [block((depth, width, thick), cover, at=(0, 0, seat - thick / 2), radius_m=0.4 * thick)]
    bar, make = uniform(rng, 0.018, 0.045), int(rng.integers(3))
    if make == 0:
        legs = (depth / 2 - bar, width / 2 - bar)
        parts += four_legs(rng, legs, seat - thick / 2, bar, one_of(rng, (0.0, 0.0, 0.08)), frame)
    elif make == 1:
        parts.append(cylinder(0.03, seat - 0.06, frame, at=(0, 0, 0.04), segments=14))
        for turn in 2 * np.pi * np.arange(5) / 5:
            end = 0.3 * np.array([np.cos(turn), np.sin(turn)])
            parts.append(sweep(regular(4, 0.025), [(0, 0, 0.07), (*end, 0.045)], frame))
            parts.append(superellipsoid((0.028, 0.028, 0.028), (1, 1), frame, rings=7, around=10).moved((*end, 0.028)))
    else:
        for s in (-1, 1):
            y, x = s * (width / 2 - 0.02), depth / 2 - 0.02
            path = [(x, y, seat - thick), (x, y, 0.05), (x - 0.04, y, 0.014), (0.04 - x, y, 0.014), (-x, y, 0.05)]
            parts.append(tube([*path, (-x, y, seat - thick)], 0.013, frame))
    if chance(rng, 0.85):
        parts += _chair_back(rng, (depth, width, seat), uniform(rng, 0.25, 0.6), frame, cover)
    return grounded("chair", parts)


def _chair_back(
    rng: np.random.Generator, seat: tuple[float, float, float], high: float, frame: Texture, cover: Texture
) -> list[Part]:
    depth, width, z = seat
    x, make, lean = 0.02 - depth / 2, int(rng.integers(3)), about_y(-uniform(rng, 0.0, 0.2))
    posts = [block((0.025, 0.03, high), frame, at=(0, s * (width / 2 - 0.02), high / 2 - 0.03)) for s in (-1, 1)]
    if make == 0:
        rows = count(rng, 1, 4)
        slats = [
            block((0.016, width - 0.03, 0.6 * high / (rows + 1)), frame, at=(0, 0, high * (i + 1) / (rows + 1)))
            for i in range(rows)
        ]
    elif make == 1:
        slats = [cylinder(0.008, high, frame, at=(0, y, -0.02), segments=8) for y in np.linspace(-0.4, 0.4, 6) * width]
        slats.append(block((0.03, width, 0.04), frame, at=(0, 0, high - 0.03)))
    else:
        slats = [block((uniform(rng, 0.015, 0.08), width, high * 0.8), cover, at=(0, 0, high * 0.55), radius_m=0.02)]
    return [part.moved((x, 0, z), lean) for part in (*posts, *slats)]


def shell_chair(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a bent sheet, seat and back in one, on thin legs."""
    width, seat, high = uniform(rng, 0.4, 0.52), uniform(rng, 0.4, 0.48), uniform(rng, 0.3, 0.45)
    s, t = np.meshgrid(np.linspace(0, 1, 15), np.linspace(-1, 1, 11), indexing="ij")
    x = np.where(s < 0.5, 0.2 - 0.8 * s, -0.2 - 0.12 * (s - 0.5))
    z = seat + np.where(s < 0.5, 0.02 * (0.5 - s), high * np.maximum(2 * s - 1, 0.0) ** 0.9)
    z = z + 0.05 * t**2
    points = np.stack([x, t * width / 2, z], axis=-1)[::-1]
    shell = sheet(points, 0.012, skin(rng))
    legs = four_legs(rng, (0.13, 0.14), seat, 0.025, uniform(rng, 0.05, 0.15), skin(rng))
    return grounded("shell_chair", [shell, *legs])


SEATS: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f
    for f in (
        chair,
        shell_chair,
    )
}
"""The recipes of seats by name."""
