"""Furniture that stands on the floor, its front along +x: one function per kind, drawn from the seed."""

from dataclasses import replace

import numpy as np

from hickory_stream.worlds.object_models import Model, Part, Surface, ellipsoid, lathe, rounded_box, tube
from hickory_stream.worlds.palettes import coat, fabric, glaze, plain, wood
from hickory_stream.worlds.textures import Texture


def table(rng: np.random.Generator) -> Model:
    """Return a dining table, its long side along y, on four legs at the corners."""
    length, depth = float(rng.uniform(1.25, 1.45)), float(rng.uniform(0.75, 0.85))
    return _table("table", rng, length=length, depth=depth, height=float(rng.uniform(0.72, 0.76)))


def desk(rng: np.random.Generator) -> Model:
    """Return a desk with a modesty panel at its back, on four legs."""
    length, depth = float(rng.uniform(1.15, 1.35)), float(rng.uniform(0.60, 0.68))
    model = _table("desk", rng, length=length, depth=depth, height=float(rng.uniform(0.71, 0.75)))
    panel = rounded_box(
        (0.018, length - 0.16, 0.34), coat(rng), at=(0.05 - depth / 2, 0.0, model.surfaces[0].center_m[2] - 0.20)
    )
    return replace(model, parts=(*model.parts, panel))


def _table(kind: str, rng: np.random.Generator, *, length: float, depth: float, height: float) -> Model:
    top_m, leg_m = float(rng.uniform(0.028, 0.04)), float(rng.uniform(0.05, 0.07))
    board = wood(rng, axis=1)
    leg = board if rng.random() < 0.5 else coat(rng)
    parts = [rounded_box((depth, length, top_m), board, at=(0, 0, height - top_m / 2), radius_m=0.008)]
    x, y = depth / 2 - leg_m / 2 - 0.02, length / 2 - leg_m / 2 - 0.02
    parts.extend(
        rounded_box((leg_m, leg_m, height - top_m), leg, at=(*at, (height - top_m) / 2))
        for at in ((x, y), (x, -y), (-x, y), (-x, -y))
    )
    surface = Surface(center_m=(0.0, 0.0, height), half_m=(depth / 2 - 0.04, length / 2 - 0.04))
    return Model(kind=kind, parts=tuple(parts), surfaces=(surface,))


def chair(rng: np.random.Generator) -> Model:
    """Return a chair with a slatted back at -x: one looks along +x when sitting on it."""
    width, depth, seat_z = (
        float(rng.uniform(0.40, 0.44)),
        float(rng.uniform(0.40, 0.44)),
        float(rng.uniform(0.44, 0.47)),
    )
    back_z, leg_m = float(rng.uniform(0.82, 0.92)), 0.036
    frame = wood(rng, axis=2)
    seat = fabric(rng) if rng.random() < 0.6 else frame
    x, y = depth / 2 - leg_m / 2, width / 2 - leg_m / 2
    parts = [rounded_box((depth, width, 0.04), seat, at=(0.0, 0.0, seat_z - 0.02), radius_m=0.014)]
    for sy in (-y, y):
        parts.append(rounded_box((leg_m, leg_m, seat_z - 0.035), frame, at=(x, sy, (seat_z - 0.035) / 2)))
        parts.append(rounded_box((leg_m, leg_m, back_z), frame, at=(-x, sy, back_z / 2)))
    parts.extend(_chair_back(rng, frame, x=-x, width=width, seat_z=seat_z, back_z=back_z))
    return Model(kind="chair", parts=tuple(parts))


def _chair_back(
    rng: np.random.Generator, frame: Texture, *, x: float, width: float, seat_z: float, back_z: float
) -> list[Part]:
    if rng.random() < 0.5:
        height = 0.6 * (back_z - seat_z)
        return [rounded_box((0.02, width - 0.06, height), frame, at=(x, 0.0, back_z - height / 2 - 0.01))]
    heights = np.linspace(seat_z + 0.12, back_z - 0.04, 3)
    return [rounded_box((0.02, width - 0.06, 0.06), frame, at=(x, 0.0, float(z))) for z in heights]


def sofa(rng: np.random.Generator) -> Model:
    """Return a sofa for two or three, with cushions and feet."""
    length, depth, seat_z = float(rng.uniform(1.55, 1.95)), float(rng.uniform(0.80, 0.90)), 0.42
    cloth, foot = fabric(rng), wood(rng, axis=2)
    arm, back, seats = 0.17, 0.20, 2 if length < 1.75 else 3
    half = depth / 2
    parts = [
        rounded_box((depth - 0.03, length - 0.02, 0.20), cloth, at=(0.0, 0.0, 0.19), radius_m=0.03),
        rounded_box((back, length - 0.02, 0.72), cloth, at=(back / 2 - half, 0.0, 0.45), radius_m=0.06),
    ]
    for y in (-1, 1):
        at = (0.0, y * (length - arm) / 2, 0.345)
        parts.append(rounded_box((depth, arm, 0.51), cloth, at=at, radius_m=0.06))
        parts.extend(
            rounded_box((0.06, 0.06, 0.10), foot, at=(x * (half - 0.08), y * (length / 2 - 0.09), 0.05))
            for x in (-1, 1)
        )
    inner = (length - 2 * arm) / seats
    for i in range(seats):
        at = (back / 2 + 0.005, (i - (seats - 1) / 2) * inner, seat_z - 0.07)
        parts.append(rounded_box((depth - back, inner - 0.01, 0.15), cloth, at=at, radius_m=0.045))
    return Model(kind="sofa", parts=tuple(parts))


def shelf(rng: np.random.Generator) -> Model:
    """Return an open bookcase with its back at -x; its boards are surfaces, lowest first."""
    width, depth, height = (
        float(rng.uniform(0.75, 0.95)),
        float(rng.uniform(0.28, 0.33)),
        float(rng.uniform(1.30, 1.65)),
    )
    board, thick = wood(rng, axis=1), 0.022
    levels = np.linspace(0.06, height - thick / 2, 5)
    parts = [rounded_box((depth, thick, height), board, at=(0, y * (width - thick) / 2, height / 2)) for y in (-1, 1)]
    parts.append(rounded_box((0.012, width - 0.03, height - 0.05), board, at=(0.006 - depth / 2, 0.0, height / 2)))
    parts.extend(
        rounded_box((depth - 0.01, width - 0.03, thick), board, at=(0.005, 0.0, float(z)), radius_m=0.003)
        for z in levels
    )
    gap = float(levels[1] - levels[0]) - thick
    surfaces = tuple(
        Surface(
            center_m=(0.01, 0.0, float(z) + thick / 2),
            half_m=(depth / 2 - 0.03, width / 2 - 0.04),
            headroom_m=gap if z < levels[-1] else 1.0,
        )
        for z in levels
    )
    return Model(kind="shelf", parts=tuple(parts), surfaces=surfaces)


def lamp(rng: np.random.Generator) -> Model:
    """Return a floor lamp: a heavy foot, a pole, a hollow shade."""
    height, radius = float(rng.uniform(1.40, 1.60)), float(rng.uniform(0.15, 0.19))
    metal = coat(rng)
    color = ((0.93, 0.87, 0.72), (0.80, 0.62, 0.42), (0.75, 0.80, 0.82))[int(rng.integers(3))]
    shade = Texture(pattern="stripes", first=color, second=(color[0] * 0.86, color[1] * 0.86, color[2] * 0.84), axis=2)
    top, low = height, height - 0.28
    skin = 0.008
    parts = (
        lathe([(0, 0), (0.14, 0), (0.14, 0.02), (0.03, 0.035), (0, 0.035)], metal),
        tube([(0, 0, 0.03), (0, 0, height / 2), (0, 0, top - 0.04)], 0.014, metal),
        # A bell closed at its top: a ring alone would float beside the pole.
        lathe(
            [
                (0, top - skin),
                (radius - skin - 0.05, top - skin),
                (radius - skin, low),
                (radius, low),
                (radius - 0.05, top),
                (0, top),
            ],
            shade,
        ),
    )
    return Model(kind="lamp", parts=parts)


def plant(rng: np.random.Generator) -> Model:
    """Return a potted plant: a filled pot and leaves on arching stems."""
    radius, pot_z = float(rng.uniform(0.14, 0.17)), float(rng.uniform(0.26, 0.32))
    pot, soil = glaze(rng, "plain"), plain((0.24, 0.17, 0.12), grain=0.5)
    green = float(rng.uniform(0.34, 0.5))
    leaf = Texture(
        pattern="speckle", first=(0.16, green, 0.15), second=(0.30, green + 0.15, 0.22), period_m=0.03, grain=0.3
    )
    vessel = [(0, 0), (0.72 * radius, 0), (radius, pot_z), (radius - 0.015, pot_z), (radius - 0.02, pot_z - 0.03)]
    parts = [
        lathe([*vessel, (0, pot_z - 0.03)], pot),
        ellipsoid((radius - 0.025,) * 2 + (0.02,), soil, at=(0, 0, pot_z - 0.03)),
    ]
    count = int(rng.integers(9, 13))
    for i in range(count):
        parts.extend(_stem(rng, leaf, yaw=2.4 * i, base_z=pot_z - 0.03, reach=float(rng.uniform(0.10, 0.26))))
    return Model(kind="plant", parts=tuple(parts))


def _stem(rng: np.random.Generator, leaf: Texture, *, yaw: float, base_z: float, reach: float) -> list[Part]:
    rise = float(rng.uniform(0.35, 0.75)) * (1.15 - reach)
    steps = np.linspace(0.0, 1.0, 6)
    out = 0.02 + reach * steps**1.7
    path = np.stack([np.cos(yaw) * out, np.sin(yaw) * out, base_z + rise * steps], axis=1)
    tilt = float(rng.uniform(0.3, 1.0))
    c, s, ct, st = np.cos(yaw), np.sin(yaw), np.cos(tilt), np.sin(tilt)
    # Columns: along the leaf (outwards and down), across it, its thin normal.
    rotation = np.array([[c * ct, -s, c * st], [s * ct, c, s * st], [-st, 0.0, ct]])
    size = (float(rng.uniform(0.10, 0.14)), float(rng.uniform(0.05, 0.075)), 0.008)
    at = path[-1] + rotation[:, 0] * size[0] * 0.8
    return [tube(path.tolist(), 0.006, leaf, segments=6), ellipsoid(size, leaf, at=at.tolist(), rotation=rotation)]


def bin_(rng: np.random.Generator) -> Model:
    """Return an open waste bin."""
    radius, height, skin = float(rng.uniform(0.12, 0.15)), float(rng.uniform(0.28, 0.36)), 0.006
    return Model(kind="bin", parts=(vessel(radius * 0.78, radius, height, skin, coat(rng)),))


def vessel(foot_m: float, rim_m: float, height_m: float, skin_m: float, texture: Texture) -> Part:
    """Return an open conical vessel with a wall of `skin_m`."""
    profile = [(0.0, 0.0), (foot_m, 0.0), (0.5 * (foot_m + rim_m), height_m / 2), (rim_m, height_m)]
    profile += [(rim_m - skin_m, height_m), (0.5 * (foot_m + rim_m) - skin_m, height_m / 2)]
    return lathe([*profile, (foot_m - skin_m, skin_m), (0.0, skin_m)], texture)
