"""Furniture on which things stand, of random design; fronts face +x, `surfaces` are sorted, lowest first."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Surface
from tools.worlds.clutter.draws import chance, count, log_uniform, uniform
from tools.worlds.clutter.objects.materials import Skin
from tools.worlds.clutter.objects.solids import block, cylinder, regular, sweep, warped
from tools.worlds.clutter.objects.units import FREE_M, four_legs, fronts, level_top


def table(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a table or a desk of any height on four legs, of any section and lean, its long side along y."""
    depth, length, height = uniform(rng, 0.45, 1.0), uniform(rng, 0.7, 2.2), uniform(rng, 0.35, 0.95)
    top, board, leg = uniform(rng, 0.012, 0.06), skin(rng), skin(rng)
    parts = [block((depth, length, top), board, at=(0, 0, height - top / 2), radius_m=uniform(rng, 0.001, top / 2))]
    thick, lean = uniform(rng, 0.02, 0.09), uniform(rng, 0.0, 0.12) if chance(rng, 0.4) else 0.0
    inset = thick / 2 + uniform(rng, 0.0, 0.06) + lean * height
    parts += four_legs(rng, (depth / 2 - inset, length / 2 - inset), height - top / 2, thick, lean, leg)
    if chance(rng, 0.4):
        apron = uniform(rng, 0.04, 0.12)
        parts += [
            block((0.018, length - 2 * inset, apron), leg, at=(s * (depth / 2 - inset), 0, height - top - apron / 2))
            for s in (-1, 1)
        ]
    return Model(kind="table", parts=tuple(parts), surfaces=(level_top(depth, length, height),))


def round_table(rng: np.random.Generator, skin: Skin) -> Model:
    radius, height, top = uniform(rng, 0.2, 0.6), uniform(rng, 0.35, 1.05), uniform(rng, 0.015, 0.05)
    metal = skin(rng)
    parts = (
        cylinder(radius, top, skin(rng), at=(0, 0, height - top), segments=40),
        cylinder(uniform(rng, 0.02, 0.06), height - top / 2, metal, segments=16),
        cylinder(radius * uniform(rng, 0.5, 0.8), 0.03, metal, top_radius_m=0.1, segments=28),
    )
    half = 0.68 * radius
    surface = Surface(center_m=(0.0, 0.0, height), half_m=(half, half), headroom_m=FREE_M)
    oval = stretched_xy(Model(kind="round_table", parts=parts, surfaces=(surface,)), uniform(rng, 1.0, 1.5))
    return oval if chance(rng, 0.3) else Model(kind="round_table", parts=parts, surfaces=(surface,))


def stretched_xy(model: Model, along: float) -> Model:
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
    return Model(kind="trestle", parts=tuple(parts), surfaces=(level_top(depth, length, height),))


def cabinet(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a closed body with drawers or doors, from a chest to a wardrobe; low ones carry things."""
    depth, width, height = uniform(rng, 0.3, 0.65), uniform(rng, 0.35, 1.4), log_uniform(rng, 0.4, 2.2)
    body, front, knob = skin(rng), skin(rng), skin(rng)
    plinth = uniform(rng, 0.0, 0.12)
    parts = [block((depth, width, height - plinth), body, at=(0, 0, plinth + (height - plinth) / 2))]
    if plinth > 0.02:
        parts.append(block((depth - 0.08, width - 0.06, plinth + 0.01), body, at=(0, 0, (plinth + 0.01) / 2)))
    columns, rows = count(rng, 1, max(1, int(width / 0.4))), count(rng, 1, max(1, int(height / 0.22)))
    parts += fronts(rng, (depth, width, height), plinth, (columns, rows), front, knob)
    surfaces = (level_top(depth, width, height),) if height < 1.6 else ()
    return Model(kind="cabinet", parts=tuple(parts), surfaces=surfaces)


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
        parts += fronts(rng, (inner[0], inner[1], inner[2]), 0.08, fields, skin(rng), skin(rng))
    return Model(kind="counter", parts=tuple(parts), surfaces=(level_top(depth, width, height),))


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
        level_top(depth - 0.04, width - 2 * post - 0.02, float(z) + thick / 2, headroom=gap if z < zs[-1] else 0.5)
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


def pallet(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a low platform of boards on blocks; cartons stand on it."""
    x, y, wood = uniform(rng, 0.6, 1.2), uniform(rng, 0.8, 1.2), skin(rng)
    pitch = uniform(rng, 0.11, 0.18)
    boards = np.arange(-y / 2 + pitch / 2, y / 2, pitch)
    parts = [block((x, pitch * 0.75, 0.02), wood, at=(0, v, 0.13)) for v in boards]
    parts += [block((0.1, y - 0.02, 0.12), wood, at=(u, 0, 0.06)) for u in (-x / 2 + 0.06, 0, x / 2 - 0.06)]
    return Model(kind="pallet", parts=tuple(parts), surfaces=(level_top(x, y - pitch / 2, 0.14, headroom=2.0),))


SUPPORTS: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f for f in (
        table, round_table, trestle, cabinet, counter, shelf, rack, cube_shelf, sofa, bed, pallet,
    )
}  # fmt: skip
"""The recipes of supports by name."""
