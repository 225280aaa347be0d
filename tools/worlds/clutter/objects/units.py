"""Chairs, units that stand flush in rows (back at -x), and the legs, fronts and tops that kinds of furniture share."""

from collections.abc import Callable

import numpy as np

from hickory_stream.worlds.object_models import Model, Part, Surface, tube
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import about_y, chance, count, log_uniform, one_of, uniform
from tools.worlds.clutter.objects.materials import Skin
from tools.worlds.clutter.objects.solids import block, cylinder, grounded, regular, sheet, superellipsoid, sweep, torus

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
    rng: np.random.Generator, size: tuple[float, float, float], plinth: float, fields: tuple[int, int], front: Texture,
    knob: Texture,
) -> list[Part]:  # fmt: skip
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


UNITS: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f for f in (appliance, kitchen_unit, tower)
}
"""The recipes of units by name."""


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


SEATS: dict[str, Callable[[np.random.Generator, Skin], Model]] = {f.__name__: f for f in (chair, shell_chair)}
"""The recipes of seats by name."""
