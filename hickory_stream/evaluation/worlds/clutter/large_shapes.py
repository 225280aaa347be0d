"""What stands on the floor, of random make: one function per recipe; fronts look along +x.

The level places of a model on which things go are its surfaces, lowest first.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.evaluation.worlds.clutter.draws import (
    about_x,
    about_y,
    about_z,
    chance,
    count,
    log_uniform,
    one_of,
    uniform,
)
from hickory_stream.evaluation.worlds.clutter.small_shapes import crumpled, open_box, regular
from hickory_stream.evaluation.worlds.clutter.solids import (
    block,
    cylinder,
    grounded,
    rough,
    sheet,
    superellipsoid,
    sweep,
    torus,
    warped,
)
from hickory_stream.evaluation.worlds.furniture import vessel
from hickory_stream.evaluation.worlds.parts import Model, Part, Surface, lathe, tube

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.evaluation.worlds.clutter.materials import Skin
    from hickory_stream.evaluation.worlds.textures import Texture

_FREE_M = 1.0


def table(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a table or a desk of any height on four legs, of any section and lean, its long side along y."""
    depth, length, height = uniform(rng, 0.45, 1.0), uniform(rng, 0.7, 2.2), uniform(rng, 0.35, 0.95)
    top, board, leg = uniform(rng, 0.012, 0.06), skin(rng), skin(rng)
    parts = [block((depth, length, top), board, at=(0, 0, height - top / 2), radius_m=uniform(rng, 0.001, top / 2))]
    thick, lean = uniform(rng, 0.02, 0.09), uniform(rng, 0.0, 0.12) if chance(rng, 0.4) else 0.0
    inset = thick / 2 + uniform(rng, 0.0, 0.06) + lean * height
    parts += _four_legs(rng, (depth / 2 - inset, length / 2 - inset), height - top / 2, thick, lean, leg)
    if chance(rng, 0.4):
        apron = uniform(rng, 0.04, 0.12)
        parts += [
            block((0.018, length - 2 * inset, apron), leg, at=(s * (depth / 2 - inset), 0, height - top - apron / 2))
            for s in (-1, 1)
        ]
    return Model(kind="table", parts=tuple(parts), surfaces=(_top(depth, length, height),))


def _four_legs(
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


def _top(depth: float, length: float, height: float, x: float = 0.0, headroom: float = _FREE_M) -> Surface:
    """Return a surface a centimetre within the border of a board."""
    return Surface(center_m=(x, 0.0, height), half_m=(depth / 2 - 0.01, length / 2 - 0.01), headroom_m=headroom)


def round_table(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a round or oval table on one column."""
    radius, height, top = uniform(rng, 0.2, 0.6), uniform(rng, 0.35, 1.05), uniform(rng, 0.015, 0.05)
    metal = skin(rng)
    parts = (
        cylinder(radius, top, skin(rng), at=(0, 0, height - top), segments=40),
        cylinder(uniform(rng, 0.02, 0.06), height - top / 2, metal, segments=16),
        cylinder(radius * uniform(rng, 0.5, 0.8), 0.03, metal, top_radius_m=0.1, segments=28),
    )
    half = 0.68 * radius
    surface = Surface(center_m=(0.0, 0.0, height), half_m=(half, half), headroom_m=_FREE_M)
    oval = stretched_xy(Model(kind="round_table", parts=parts, surfaces=(surface,)), uniform(rng, 1.0, 1.5))
    return oval if chance(rng, 0.3) else Model(kind="round_table", parts=parts, surfaces=(surface,))


def stretched_xy(model: Model, along: float) -> Model:
    """Return a model that is longer along y."""
    parts = tuple(warped(part, lambda vertices: vertices * (1.0, along, 1.0)) for part in model.parts)
    surfaces = tuple(replace(s, half_m=(s.half_m[0], s.half_m[1] * along)) for s in model.surfaces)
    return replace(model, parts=parts, surfaces=surfaces)


def trestle(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a board on two panels, two A frames or two blocks."""
    depth, length, height = uniform(rng, 0.5, 0.9), uniform(rng, 1.0, 2.2), uniform(rng, 0.4, 0.8)
    top, board, side = uniform(rng, 0.02, 0.05), skin(rng), skin(rng)
    parts = [block((depth, length, top), board, at=(0, 0, height - top / 2))]
    out, make = length * uniform(rng, 0.3, 0.45), int(rng.integers(3))
    for s in (-1, 1):
        if make == 0:
            parts.append(block((depth * 0.85, 0.03, height - top), side, at=(0, s * out, (height - top) / 2)))
        elif make == 1:
            size = (depth * 0.7, uniform(rng, 0.2, 0.4), height - top)
            parts.append(block(size, side, at=(0, s * out, (height - top) / 2)))
        else:
            for lean in (-1, 1):
                path = [(lean * depth * 0.45, s * out, 0.012), (lean * 0.03, s * out, height - top)]
                parts.append(sweep(regular(4, 0.03), path, side))
            low = min(float(part.vertices[:, 2].min()) for part in parts)
            parts = [part if part is parts[0] else part.moved((0, 0, -low)) for part in parts]
    return Model(kind="trestle", parts=tuple(parts), surfaces=(_top(depth, length, height),))


def cabinet(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a closed body with drawers or doors, from a chest to a wardrobe; low ones carry things."""
    depth, width, height = uniform(rng, 0.3, 0.65), uniform(rng, 0.35, 1.4), log_uniform(rng, 0.4, 2.2)
    body, front, knob = skin(rng), skin(rng), skin(rng)
    plinth = uniform(rng, 0.0, 0.12)
    parts = [block((depth, width, height - plinth), body, at=(0, 0, plinth + (height - plinth) / 2))]
    if plinth > 0.02:
        parts.append(block((depth - 0.08, width - 0.06, plinth + 0.01), body, at=(0, 0, (plinth + 0.01) / 2)))
    columns, rows = count(rng, 1, max(1, int(width / 0.4))), count(rng, 1, max(1, int(height / 0.22)))
    parts += _fronts(rng, (depth, width, height), plinth, (columns, rows), front, knob)
    surfaces = (_top(depth, width, height),) if height < 1.6 else ()
    return Model(kind="cabinet", parts=tuple(parts), surfaces=surfaces)


def _fronts(
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


def counter(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a long body with a top that stands out: counters, bars, work benches."""
    depth, width, height = uniform(rng, 0.45, 0.8), uniform(rng, 1.2, 3.0), uniform(rng, 0.7, 1.15)
    top, lip, body = uniform(rng, 0.02, 0.08), uniform(rng, 0.0, 0.06), skin(rng)
    inner = (depth - 2 * lip, width - 2 * lip, height - top)
    parts = [
        block(inner, body, at=(0, 0, inner[2] / 2)),
        block((depth, width, top), skin(rng), at=(0, 0, height - top / 2)),
    ]
    if chance(rng, 0.6):
        fields = (count(rng, 2, 6), count(rng, 1, 3))
        parts += _fronts(rng, (inner[0], inner[1], inner[2]), 0.08, fields, skin(rng), skin(rng))
    return Model(kind="counter", parts=tuple(parts), surfaces=(_top(depth, width, height),))


def shelf(rng: np.random.Generator, skin: Skin) -> Model:
    """Return an open case of columns and rows, with or without a back; every compartment is a surface."""
    depth, width, height = uniform(rng, 0.2, 0.5), uniform(rng, 0.4, 2.4), uniform(rng, 0.5, 2.3)
    columns, rows = max(1, round(width / uniform(rng, 0.35, 1.1))), max(2, round(height / uniform(rng, 0.25, 0.5)))
    thick, board = uniform(rng, 0.012, 0.04), skin(rng)
    low = uniform(rng, 0.0, 0.12)
    ys = np.linspace(-width / 2 + thick / 2, width / 2 - thick / 2, columns + 1)
    zs = np.linspace(low + thick / 2, height - thick / 2, rows + 1)
    parts = [block((depth, thick, height), board, at=(0, y, height / 2), radius_m=0.002) for y in ys]
    parts += [block((depth - 0.002, width - 0.002, thick), board, at=(0, 0, z), radius_m=0.002) for z in zs]
    if chance(rng, 0.6):
        parts.append(
            block((0.008, width - 0.01, height - low), skin(rng), at=(0.004 - depth / 2, 0, (height + low) / 2))
        )
    return Model(kind="shelf", parts=tuple(parts), surfaces=_compartments(depth, ys, zs, thick))


def _compartments(depth: float, ys: NDArray[np.float64], zs: NDArray[np.float64], thick: float) -> tuple[Surface, ...]:
    """Return a surface on each board in each column, and one on top where one sees it."""
    gap = float(zs[1] - zs[0]) - thick
    cells = [
        Surface(
            center_m=(0.008, float(y0 + y1) / 2, float(z) + thick / 2),
            half_m=(depth / 2 - 0.014, float(y1 - y0) / 2 - thick / 2 - 0.004),
            headroom_m=gap - 0.01,
        )
        for z in zs[:-1]
        for y0, y1 in pairwise(ys)
    ]
    if zs[-1] < 1.7:
        half = (depth / 2 - 0.01, float(ys[-1] - ys[0]) / 2 - 0.01)
        cells.append(Surface(center_m=(0.0, 0.0, float(zs[-1]) + thick / 2), half_m=half, headroom_m=0.5))
    return tuple(cells)


def rack(rng: np.random.Generator, skin: Skin) -> Model:
    """Return posts that carry boards, grates or slats: store racks, wire shelves; one looks through."""
    depth, width, height = uniform(rng, 0.3, 0.9), uniform(rng, 0.6, 2.6), uniform(rng, 0.8, 2.6)
    post, metal, deck = uniform(rng, 0.02, 0.08), skin(rng), skin(rng)
    rows, make, thick = count(rng, 2, 5), int(rng.integers(3)), uniform(rng, 0.015, 0.05)
    zs = np.linspace(uniform(rng, 0.08, 0.3), height - uniform(rng, 0.02, 0.3), rows)
    x, y = (depth - post) / 2, (width - post) / 2
    parts = [block((post, post, height), metal, at=(sx * x, sy * y, height / 2)) for sx in (-1, 1) for sy in (-1, 1)]
    for z in zs:
        if make == 0:
            parts.append(block((depth - 0.01, width - 0.01, thick), deck, at=(0, 0, z)))
            continue
        parts += [block((0.03, width - 0.004, thick), metal, at=(s * (x - 0.002), 0, z)) for s in (-1, 1)]
        pitch = uniform(rng, 0.05, 0.12)
        bar = pitch * (0.25 if make == 1 else 0.75)
        for v in np.arange(-y + pitch / 2, y, pitch):
            parts.append(block((depth - 0.02, bar, 0.6 * thick), deck, at=(0, v, z), radius_m=0.001))
    gap = float(zs[1] - zs[0]) - thick
    surfaces = tuple(
        _top(depth - 0.04, width - 2 * post - 0.02, float(z) + thick / 2, headroom=gap if z < zs[-1] else 0.5)
        for z in zs
        if z < 1.8
    )
    return Model(kind="rack", parts=tuple(parts), surfaces=surfaces)


def cube_shelf(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a staircase of equal open cubes."""
    side, thick, board = uniform(rng, 0.28, 0.42), uniform(rng, 0.012, 0.03), skin(rng)
    parts, surfaces = [], []
    columns = count(rng, 2, 4)
    heights = np.sort(rng.integers(1, 5, size=columns))
    for i, high in enumerate(heights):
        y = (i - (columns - 1) / 2) * side
        for j in range(int(high)):
            z = j * side
            parts += [
                block((side, thick, side), board, at=(0, y + s * (side - thick) / 2, z + side / 2)) for s in (-1, 1)
            ]
            parts += [
                block((side, side, thick), board, at=(0, y, z + side / 2 + s * (side - thick) / 2)) for s in (-1, 1)
            ]
            half = side / 2 - thick - 0.004
            surfaces.append(
                Surface(center_m=(0.0, y, z + thick), half_m=(half, half), headroom_m=side - 2 * thick - 0.01)
            )
    return Model(kind="cube_shelf", parts=tuple(parts), surfaces=tuple(surfaces))


def ladder_shelf(rng: np.random.Generator, skin: Skin) -> Model:
    """Return boards of growing depth between two ladders that lean back."""
    width, height, rows = uniform(rng, 0.5, 1.0), uniform(rng, 1.2, 1.9), count(rng, 3, 5)
    board, bar, deep = skin(rng), skin(rng), uniform(rng, 0.35, 0.5)
    parts, surfaces = [], []
    for s in (-1, 1):
        y = s * width / 2
        for x0, x1 in ((deep, 0.03), (0.0, 0.0)):
            parts.append(sweep(regular(4, 0.025), [(x0, y, 0.02), (x1, y, height)], bar))
    for i in range(rows):
        z = height * (i + 0.5) / (rows + 0.3)
        depth = deep * (1 - z / height) + 0.1
        parts.append(block((depth, width, 0.022), board, at=(depth / 2 - 0.02, 0, z)))
        half = (depth / 2 - 0.02, width / 2 - 0.04)
        surfaces.append(
            Surface(
                center_m=(depth / 2 - 0.02, 0.0, z + 0.011), half_m=half, headroom_m=0.9 * height / (rows + 0.3) - 0.03
            )
        )
    low = min(float(part.vertices[:, 2].min()) for part in parts)
    shifted = [replace(s, center_m=(s.center_m[0], 0.0, s.center_m[2] - low)) for s in surfaces]
    return Model(kind="ladder_shelf", parts=tuple(part.moved((0, 0, -low)) for part in parts), surfaces=tuple(shifted))


def trolley(rng: np.random.Generator, skin: Skin) -> Model:
    """Return two or three trays between posts on wheels."""
    depth, width, height = uniform(rng, 0.35, 0.55), uniform(rng, 0.45, 0.9), uniform(rng, 0.6, 1.0)
    metal, pan, wheel = skin(rng), skin(rng), skin(rng)
    parts, surfaces = [], []
    zs = np.linspace(0.14, height - 0.08, count(rng, 2, 3))
    for z in zs:
        inner = open_box("pan", (depth, width, 0.06), 0.008, pan)
        parts += [part.moved((0, 0, z)) for part in inner.parts]
        surfaces.append(_top(depth - 0.05, width - 0.05, float(z) + 0.008, headroom=float(zs[1] - zs[0]) - 0.05))
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sx * (depth / 2 - 0.012), sy * (width / 2 - 0.012)
            parts.append(cylinder(0.012, height - 0.06, metal, at=(x, y, 0.06), segments=10))
            parts.append(cylinder(0.035, 0.02, wheel, segments=16).moved((x, y - 0.01, 0.035), about_x(np.pi / 2)))
    return Model(kind="trolley", parts=tuple(parts), surfaces=tuple(surfaces))


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
    surfaces = (_top(depth, width, height),) if height < 1.5 else ()
    return Model(kind="appliance", parts=tuple(parts), surfaces=surfaces)


def chair(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a chair or a bar stool: legs, sled or star foot; a back of boards, bars or one bent sheet, or none."""
    width, depth, seat = uniform(rng, 0.36, 0.55), uniform(rng, 0.36, 0.52), uniform(rng, 0.38, 0.78)
    frame, cover, thick = skin(rng), skin(rng), uniform(rng, 0.015, 0.09)
    parts = [block((depth, width, thick), cover, at=(0, 0, seat - thick / 2), radius_m=0.4 * thick)]
    bar, make = uniform(rng, 0.018, 0.045), int(rng.integers(3))
    if make == 0:
        legs = (depth / 2 - bar, width / 2 - bar)
        parts += _four_legs(rng, legs, seat - thick / 2, bar, one_of(rng, (0.0, 0.0, 0.08)), frame)
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
    legs = _four_legs(rng, (0.13, 0.14), seat, 0.025, uniform(rng, 0.05, 0.15), skin(rng))
    return grounded("shell_chair", [shell, *legs])


def sofa(rng: np.random.Generator, skin: Skin) -> Model:
    """Return upholstery for one to four, with or without arms and back; its seat carries cushions."""
    width, depth, seat = uniform(rng, 0.6, 2.4), uniform(rng, 0.6, 1.0), uniform(rng, 0.32, 0.48)
    cloth, foot, low = skin(rng), skin(rng), uniform(rng, 0.03, 0.14)
    back, arm = uniform(rng, 0.1, 0.26), uniform(rng, 0.08, 0.24) if chance(rng, 0.75) else 0.0
    soft = uniform(rng, 0.02, 0.07)
    parts = [block((depth, width, seat * 0.62 - low), cloth, at=(0, 0, (seat * 0.62 + low) / 2), radius_m=soft)]
    high = seat + uniform(rng, 0.25, 0.5)
    if chance(rng, 0.9):
        parts.append(
            block((back, width, high - low), cloth, at=((back - depth) / 2, 0, (high + low) / 2), radius_m=soft)
        )
    else:
        back = 0.0
    for s in (-1, 1) if arm else ():
        top = seat + uniform(rng, 0.1, 0.25)
        parts.append(
            block((depth, arm, top - low), cloth, at=(0, s * (width - arm) / 2, (top + low) / 2), radius_m=soft)
        )
    seats, inner = max(1, round((width - 2 * arm) / 0.65)), width - 2 * arm
    for i in range(seats):
        size = (depth - back, inner / seats - 0.006, seat * 0.42)
        parts.append(
            block(size, cloth, at=(back / 2, (i + 0.5) * inner / seats - inner / 2, seat * 0.79), radius_m=soft)
        )
    x, y = depth / 2 - 0.08, width / 2 - 0.08
    parts += [
        block((0.05, 0.05, low + 0.03), foot, at=(i * x, j * y, (low + 0.03) / 2)) for i in (-1, 1) for j in (-1, 1)
    ]
    surface = Surface(center_m=(back / 2, 0.0, seat), half_m=((depth - back) / 2 - 0.03, inner / 2 - 0.03))
    return Model(kind="sofa", parts=tuple(parts), surfaces=(surface,))


def bed(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a frame with a mattress and a blanket over it; pillows are things of their own."""
    width, length, high = uniform(rng, 0.8, 1.8), uniform(rng, 1.7, 2.1), uniform(rng, 0.25, 0.55)
    frame, soft = skin(rng), uniform(rng, 0.14, 0.22)
    parts = [
        block((length, width, high - soft - 0.04), frame, at=(0, 0, (high - soft + 0.04) / 2)),
        block((length - 0.06, width - 0.04, soft), skin(rng), at=(0, 0, high - soft / 2), radius_m=0.05),
    ]
    if chance(rng, 0.7):
        board = uniform(rng, 0.2, 0.6)
        parts.append(block((0.05, width + 0.04, high + board), frame, at=(-length / 2, 0, (high + board) / 2)))
    low = min(float(part.vertices[:, 2].min()) for part in parts)
    if low > 0:
        parts += [block((0.07, width, low + 0.02), frame, at=(s * length * 0.4, 0, (low + 0.02) / 2)) for s in (-1, 1)]
    surface = Surface(center_m=(0.0, 0.0, high), half_m=(length / 2 - 0.1, width / 2 - 0.06))
    return Model(kind="bed", parts=tuple(parts), surfaces=(surface,))


def big_carton(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a closed carton or a chest of 0.25 to 0.9 m."""
    size = [log_uniform(rng, 0.25, 0.9) for _ in range(3)]
    parts = [block(size, skin(rng), at=(0, 0, size[2] / 2), radius_m=0.005)]
    if chance(rng, 0.5):
        parts.append(block((0.06, size[1] - 0.02, 0.0016), skin(rng), at=(0, 0, size[2] + 0.0004)))
    surface = Surface(center_m=(0.0, 0.0, size[2] + 0.0013), half_m=(size[0] / 2, size[1] / 2))
    return Model(kind="big_carton", parts=tuple(parts), surfaces=(surface,))


def open_carton(rng: np.random.Generator, skin: Skin) -> Model:
    """Return an open carton with flaps; things may lie in it."""
    x, y, z = uniform(rng, 0.25, 0.6), uniform(rng, 0.25, 0.6), uniform(rng, 0.15, 0.45)
    paper, wall = skin(rng), 0.005
    base = open_box("open_carton", (x, y, z), wall, paper)
    parts = list(base.parts)
    for axis, (half, long) in enumerate(((x / 2, y), (y / 2, x))):
        flap = uniform(rng, 0.3, 0.5) * min(x, y)
        for s in (-1, 1):
            lift = uniform(rng, -1.0, 1.2)
            piece = block((flap, long - 0.01, 0.004), paper, at=(flap / 2, 0, 0), radius_m=0.001)
            turn = about_z((0 if s > 0 else np.pi) + axis * np.pi / 2)
            at = (s * (half - wall / 2), 0, z) if axis == 0 else (0, s * (half - wall / 2), z)
            parts.append(piece.moved((0, 0, 0), about_y(-lift)).moved(at, turn))
    return Model(kind="open_carton", parts=tuple(parts), surfaces=base.surfaces)


def barrel(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a bin, a drum or a bucket: closed or open above."""
    radius, height = uniform(rng, 0.12, 0.32), uniform(rng, 0.25, 0.95)
    cover, top = skin(rng), uniform(rng, 0.8, 1.2)
    if chance(rng, 0.5):
        parts = [cylinder(radius, height, cover, top_radius_m=radius * top, segments=32)]
        parts.append(cylinder(radius * top + 0.012, 0.05, skin(rng), at=(0, 0, height - 0.02), segments=32))
        return grounded("barrel", parts)
    return grounded("barrel", [vessel(radius, radius * max(top, 1.0), height, 0.008, cover)])


def sack(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a full sack, a bean bag or a rucksack."""
    semi = np.array([uniform(rng, 0.15, 0.4), uniform(rng, 0.15, 0.4), uniform(rng, 0.15, 0.4)])
    part = superellipsoid(semi, (uniform(rng, 0.4, 0.9), uniform(rng, 0.5, 1.0)), skin(rng), rings=21)
    return grounded("sack", [rough(part, rng, 0.07 * float(semi.min()), 0.5 * float(semi.min()))])


def roll(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a roll that lies or stands: carpets, mats, pipes."""
    radius, length = uniform(rng, 0.05, 0.2), uniform(rng, 0.5, 1.8)
    part = cylinder(radius, length, skin(rng), segments=28)
    turn = about_x(np.pi / 2) if chance(rng, 0.6) else np.eye(3)
    return grounded("roll", [part.moved((0, 0, 0), turn)])


def floor_lamp(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a foot, a pole and a head: lamps, fans, coat stands."""
    height, radius = uniform(rng, 0.9, 1.9), uniform(rng, 0.12, 0.25)
    metal = skin(rng)
    parts = [cylinder(radius, 0.03, metal), cylinder(uniform(rng, 0.01, 0.025), height, metal, segments=10)]
    make = int(rng.integers(3))
    if make == 0:
        parts.append(cylinder(uniform(rng, 0.12, 0.28), 0.28, skin(rng), top_radius_m=0.12, at=(0, 0, height - 0.24)))
    elif make == 1:
        ring = torus(0.2, 0.02, metal).moved((0.05, 0, height), about_y(np.pi / 2))
        blades = block((0.02, 0.34, 0.08), skin(rng), at=(0.05, 0, height))
        parts += [ring, blades, block((0.02, 0.08, 0.34), skin(rng), at=(0.05, 0, height))]
    else:
        for turn in 2 * np.pi * np.arange(count(rng, 3, 6)) / 5:
            out = 0.22 * np.array([np.cos(turn), np.sin(turn)])
            path = [(0, 0, height - 0.25), (*(out * 0.6), height - 0.22), (*out, height - 0.1)]
            parts.append(tube(path, 0.012, metal, segments=8))
    return grounded("floor_lamp", parts)


def foliage(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a pot with a bush of broad leaves."""
    radius, height = uniform(rng, 0.1, 0.22), uniform(rng, 0.15, 0.4)
    pot, leaf = cylinder(radius * uniform(rng, 0.6, 0.9), height, skin(rng), top_radius_m=radius), skin(rng)
    parts, tall = [pot], uniform(rng, 0.2, 0.9)
    for _ in range(count(rng, 8, 18)):
        turn, out, up = uniform(rng, 0, 6.3), uniform(rng, 0.05, 0.32), uniform(rng, 0.2, 1.0) * tall
        end = np.array([out * np.cos(turn), out * np.sin(turn), height + up])
        parts.append(tube([(0, 0, height - 0.02), (*(end[:2] * 0.3), height + 0.6 * up), end], 0.005, leaf, segments=6))
        size = uniform(rng, 0.05, 0.14)
        broad = superellipsoid((size, size * uniform(rng, 0.3, 0.7), 0.004), (1, 1), leaf, rings=7, around=12)
        parts.append(broad.moved(end, about_z(turn) @ about_y(uniform(rng, 0.0, 1.0))))
    return grounded("foliage", parts)


def screen(rng: np.random.Generator, skin: Skin) -> Model:
    """Return an upright panel on feet: boards, folding screens, heaters, signs; thin along x."""
    width, height, thick = uniform(rng, 0.4, 1.4), uniform(rng, 0.5, 1.9), uniform(rng, 0.015, 0.1)
    cover, metal = skin(rng), skin(rng)
    low = uniform(rng, 0.0, 0.3)
    parts = [block((thick, width, height - low), cover, at=(0, 0, (height + low) / 2))]
    for s in (-1, 1):
        parts.append(block((0.3, 0.04, 0.03), metal, at=(0, s * 0.4 * width, 0.015)))
        parts.append(block((0.03, 0.04, low + 0.05), metal, at=(0, s * 0.4 * width, (low + 0.05) / 2)))
    if chance(rng, 0.4):
        parts += [
            block((thick + 0.03, 0.03, height - low), metal, at=(0, y, (height + low) / 2))
            for y in np.linspace(-0.45, 0.45, 8) * width
        ]
    return grounded("screen", parts)


def pallet(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a low platform of boards on blocks; cartons stand on it."""
    x, y, wood = uniform(rng, 0.6, 1.2), uniform(rng, 0.8, 1.2), skin(rng)
    pitch = uniform(rng, 0.11, 0.18)
    boards = np.arange(-y / 2 + pitch / 2, y / 2, pitch)
    parts = [block((x, pitch * 0.75, 0.02), wood, at=(0, v, 0.13)) for v in boards]
    parts += [block((0.1, y - 0.02, 0.12), wood, at=(u, 0, 0.06)) for u in (-x / 2 + 0.06, 0, x / 2 - 0.06)]
    return Model(kind="pallet", parts=tuple(parts), surfaces=(_top(x, y - pitch / 2, 0.14, headroom=2.0),))


def ladder(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a standing double ladder."""
    height, width, metal = uniform(rng, 0.6, 1.6), uniform(rng, 0.35, 0.5), skin(rng)
    out, parts = 0.35 * height, []
    for side in (-1, 1):
        for s in (-1, 1):
            path = [(side * out, s * width / 2, 0.0), (side * 0.04, s * width / 2, height)]
            parts.append(sweep(regular(4, 0.025), path, metal))
        for z in np.arange(0.22, height, 0.24) if side > 0 else ():
            x = side * (out + (0.04 - out) * z / height)
            parts.append(block((0.07, width, 0.025), metal, at=(x, 0, z)))
    parts.append(block((0.16, width, 0.03), skin(rng), at=(0, 0, height)))
    return grounded("ladder", parts)


def draped(rng: np.random.Generator, skin: Skin) -> Model:
    """Return something under a cloth that falls to the floor in folds."""
    size = np.array([uniform(rng, 0.3, 0.8), uniform(rng, 0.3, 0.8)]) / 2
    high, flare, folds = uniform(rng, 0.3, 1.0), uniform(rng, 0.05, 0.3), count(rng, 4, 11)
    around, down = 96, 26
    turn, phase = 2 * np.pi * np.arange(around) / around, uniform(rng, 0, 6.3)
    share = np.linspace(0.02, 1, down)
    corner = uniform(rng, 0.25, 0.8)
    side = np.stack(
        [
            np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** corner,
            np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** corner,
        ],
        axis=1,
    )
    top = np.minimum(share / 0.35, 1.0)
    fall = np.maximum(share - 0.35, 0.0) / 0.65
    waves = 1.0 + flare * fall[:, None] * (
        0.6 + 0.5 * np.sin(folds * turn + phase)[None] + 0.2 * np.sin(2 * folds * turn + 3)
    )
    rings = np.empty((down, around, 3))
    rings[..., :2] = side[None] * size * top[:, None, None] * waves[..., None]
    rings[..., 2] = (high * (1.0 - fall) + 0.02 * np.cos(np.pi / 2 * top) * high)[:, None]
    # Closed below: one solid seen from outside.
    outline = rings[::-1]
    poles = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, float(rings[0, 0, 2])]])
    closed = lathe([(0, 0), *[(1.0, 1.0)] * down, (0, 0)], skin(rng), segments=around)
    return grounded("draped", [replace(closed, vertices=np.concatenate([outline.reshape(-1, 3), poles]))])


def blanket_heap(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a big cloth that lies in a heap on the floor or a bed."""
    size = uniform(rng, 0.5, 1.1)
    return grounded(
        "blanket_heap", [crumpled(rng, (size, size * uniform(rng, 0.6, 1.0)), uniform(rng, 0.06, 0.3), skin(rng))]
    )


def rounded_body(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a smooth big body: pouffes, ottomans, exercise balls, stones."""
    semi = rng.uniform(0.18, 0.45, size=3)
    return grounded("rounded_body", [superellipsoid(semi, (uniform(rng, 0.2, 1.2), uniform(rng, 0.2, 1.2)), skin(rng))])


def machine(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a few big blocks, drums and pipes grown together: engines, printers, gym machines."""
    size = uniform(rng, 0.25, 0.5)
    skins = [skin(rng) for _ in range(3)]
    parts = [block(size * rng.uniform(0.7, 2.0, size=3), skins[0], radius_m=0.02)]
    for _ in range(count(rng, 2, 5)):
        host = parts[0].vertices
        at = host[int(rng.integers(len(host)))] * 0.8
        if chance(rng, 0.6):
            parts.append(block(size * rng.uniform(0.2, 1.0, size=3), one_of(rng, skins), at=at, radius_m=0.01))
        else:
            turn = one_of(rng, (np.eye(3), about_x(np.pi / 2), about_y(np.pi / 2)))
            drum = cylinder(size * uniform(rng, 0.1, 0.4), size * uniform(rng, 0.3, 1.2), one_of(rng, skins))
            parts.append(drum.moved(at, turn))
    return grounded("machine", parts)


def kitchen_unit(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a unit of a fitted kitchen: a body with doors or drawers under its own piece of worktop."""
    width, top = uniform(rng, 0.3, 1.0), uniform(rng, 0.02, 0.05)
    size = (0.6, width, 0.88)
    parts = [
        block((size[0] - 0.04, width, size[2] - top), skin(rng), at=(0, 0, (size[2] - top) / 2), radius_m=0.002),
        block((size[0], width, top), skin(rng), at=(0, 0, size[2] - top / 2), radius_m=0.003),
    ]
    parts += _fronts(rng, (size[0] - 0.04, width, size[2] - top), 0.1, (1, count(rng, 1, 4)), skin(rng), skin(rng))
    return Model(kind="kitchen_unit", parts=tuple(parts), surfaces=(_top(size[0], width, size[2]),))


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
    surfaces = (_top(depth, width, height),) if height < 1.5 else ()
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
    surfaces = (_top(depth, width, height),) if height < 1.5 else ()
    return Model(kind="locker", parts=tuple(parts), surfaces=surfaces)


def tent(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a cloth over a ridge, closed on all sides: tents, drying racks with sheets on them."""
    length, half, high, sag = (
        uniform(rng, 0.6, 1.6),
        uniform(rng, 0.25, 0.6),
        uniform(rng, 0.5, 1.2),
        uniform(rng, 0.0, 0.3),
    )
    across = np.linspace(-1, 1, 21)
    rise = high * (1 - np.abs(across)) ** (1 + sag)
    outline = np.stack([np.concatenate([across * half, [0.0]]), np.concatenate([rise, [0.0]])], axis=1)[::-1]
    outline = outline[1:] if rise[0] == 0.0 else outline
    path = [(0.0, -length / 2, 0.0), (0.0, 0.0, 0.0), (0.0, length / 2, 0.0)]
    part = sweep(outline, path, skin(rng))
    return grounded("tent", [rough(part, rng, 0.02, 0.4)])


LARGE_SHAPES: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f
    for f in (
        table, round_table, trestle, cabinet, counter, shelf, rack, cube_shelf, ladder_shelf, trolley, appliance, chair,
        shell_chair, sofa, bed, big_carton, open_carton, barrel, sack, roll, floor_lamp, foliage, screen, pallet,
        ladder, draped, blanket_heap, rounded_body, machine, kitchen_unit, tower, locker, tent,
    )
}  # fmt: skip
"""The recipes of large things by name."""
