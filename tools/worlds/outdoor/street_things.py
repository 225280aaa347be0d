"""Outdoor objects as composed models: fronts look along +x, the origin is on the ground."""
# Trunks and posts go on below it by `SUNK_M`, so that they meet ground that slopes.

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Part, ellipsoid, lathe, rounded_box, tube
from hickory_stream.worlds.palettes import plain, wood
from hickory_stream.worlds.textures import Color, Texture
from tools.worlds.clutter.draws import about_x, about_y, chance, count, one_of, uniform
from tools.worlds.clutter.objects.solids import block, cylinder, rough, superellipsoid, sweep, warped

SUNK_M = 0.12
_PAINTS: tuple[Color, ...] = (
    (0.72, 0.73, 0.75), (0.13, 0.14, 0.16), (0.82, 0.82, 0.80), (0.55, 0.10, 0.10), (0.12, 0.22, 0.42),
    (0.30, 0.38, 0.32), (0.62, 0.56, 0.45),
)  # fmt: skip
_RUBBER, _GLASS = plain((0.09, 0.09, 0.10)), plain((0.16, 0.19, 0.22), grain=0.03)
_IRON = plain((0.16, 0.17, 0.18))


def car(rng: np.random.Generator) -> Model:
    """Return a parked car, its front along +x: body, glazed cabin, four wheels, lamps, plates and mirrors."""
    length, width = uniform(rng, 3.5, 4.1), uniform(rng, 1.62, 1.74)
    sill, belt, top = uniform(rng, 0.2, 0.24), uniform(rng, 0.82, 0.92), uniform(rng, 1.42, 1.52)
    paint = _paint(rng)
    hood = belt - uniform(rng, 0.02, 0.1)
    is_estate = chance(rng, 0.5)
    back = -length / 2
    profile = np.array([
        (back + 0.06, sill + 0.05), (length / 2 - 0.1, sill + 0.02), (length / 2, sill + 0.28),
        (length / 2 - 0.06, hood - 0.14), (length / 2 - 0.75, hood + 0.02), (0.0, belt), (back + 0.1, belt),
        (back, sill + 0.32),
    ])  # fmt: skip
    # The outline of a side, drawn across the car: its path runs along y.
    body = _across(profile, width, paint, taper=0.06)
    glazed = np.array([
        (length / 2 - 0.85, belt - 0.03), (length / 2 - 1.45, top - 0.03),
        (back + (0.45 if is_estate else 0.95), top - 0.03), (back + (0.12 if is_estate else 0.3), belt - 0.03),
    ])  # fmt: skip
    roof = np.array([
        (length / 2 - 1.42, top - 0.05), (length / 2 - 1.55, top), (back + (0.6 if is_estate else 1.05), top),
        (back + (0.4 if is_estate else 0.9), top - 0.05),
    ])  # fmt: skip
    parts: list[Part] = [
        body,
        _across(glazed, width - 0.14, _GLASS, taper=0.12),
        _across(roof, width - 0.24, paint, taper=0.1),
    ]
    for x in (length / 2 - 0.72, back + 0.7):
        for side in (-1, 1):
            wheel = lathe([(0, 0), (0.27, 0), (0.3, 0.03), (0.3, 0.17), (0.27, 0.2), (0, 0.2)], _RUBBER, segments=24)
            hub = cylinder(0.18, 0.012, plain((0.6, 0.6, 0.62)), segments=16).moved((0, 0, 0.195))
            turn = about_x(-side * np.pi / 2)
            at = (x, side * (width / 2 - 0.17), 0.3)
            parts += [wheel.moved(at, turn), hub.moved(at, turn)]
    lamp, red, plate = plain((0.9, 0.9, 0.86)), plain((0.55, 0.05, 0.05)), plain((0.88, 0.88, 0.84))
    for side in (-1, 1):
        y = side * (width / 2 - 0.28)
        parts.append(ellipsoid((0.06, 0.15, 0.07), lamp, at=(length / 2 - 0.06, y, hood - 0.2)))
        parts.append(ellipsoid((0.05, 0.1, 0.13), red, at=(back + 0.06, side * (width / 2 - 0.2), belt - 0.18)))
        mirror = (length / 2 - 1.05, side * (width / 2 + 0.06), belt + 0.06)
        parts.append(ellipsoid((0.05, 0.1, 0.06), paint, at=mirror))
    parts.append(block((0.02, 0.5, 0.11), plate, at=(length / 2 - 0.015, 0, sill + 0.2)))
    parts.append(block((0.02, 0.5, 0.11), plate, at=(back + 0.02, 0, sill + 0.35)))
    return Model(kind="car", parts=tuple(parts))


def trunk(rng: np.random.Generator) -> Model:
    """Return the trunk of a tree: a root flare, a bend or two, stubs of branches; its crown is not part of it."""
    height, radius = uniform(rng, 2.7, 3.3), uniform(rng, 0.1, 0.2)
    lean = rng.normal(0, 0.05, size=(3, 2))
    levels = np.array([-SUNK_M, 0.0, 0.14, 0.35, 0.45 * height, 0.75 * height, height])
    path = np.zeros((len(levels), 3))
    path[:, 2] = levels
    path[4:, :2] = np.cumsum(lean, axis=0)
    bark = _bark(rng)
    parts = [tube(list(path), [f * radius for f in (1.5, 1.4, 1.12, 1.0, 0.9, 0.82, 0.7)], bark, segments=18)]
    parts[0] = rough(parts[0], rng, 0.02, 0.5)
    for _ in range(count(rng, 0, 2)):
        turn, up = uniform(rng, 0, 2 * np.pi), uniform(rng, 0.75, 0.92) * height
        out = np.array([np.cos(turn), np.sin(turn), 0.9])
        start = np.array([*path[5, :2], up])
        parts.append(tube([start, start + 0.25 * out, start + 0.5 * out], (0.05, 0.042, 0.03), bark, segments=10))
    return Model(kind="trunk", parts=tuple(parts))


def park_bench(rng: np.random.Generator) -> Model:
    """Return a bench with a back: slats on two iron frames, its long side along y."""
    length, timber = uniform(rng, 1.3, 1.8), wood(rng, axis=1)
    parts: list[Part] = [
        rounded_box((0.1, length, 0.035), timber, at=(x, 0, 0.44), cell_m=0.3) for x in (-0.17, -0.05, 0.07, 0.19)
    ]
    for z in (0.58, 0.7, 0.82):
        lean = about_y(-0.25)
        parts.append(rounded_box((0.03, length, 0.09), timber, at=(-0.25 - 0.25 * (z - 0.44), 0, z), rotation=lean))
    for side in (-1, 1):
        y = side * (length / 2 - 0.16)
        parts += [
            tube([(-0.24, y, -0.02), (-0.23, y, 0.2), (-0.24, y, 0.44), (-0.36, y, 0.86)], 0.025, _IRON),
            tube([(0.21, y, -0.02), (0.2, y, 0.2), (0.2, y, 0.42)], 0.025, _IRON),
            tube([(-0.25, y, 0.41), (0.0, y, 0.405), (0.22, y, 0.41)], 0.02, _IRON),
        ]
    return Model(kind="park_bench", parts=tuple(parts))


def bollard(rng: np.random.Generator) -> Model:
    height, radius = uniform(rng, 0.7, 1.0), uniform(rng, 0.05, 0.09)
    metal = plain(one_of(rng, ((0.17, 0.2, 0.19), (0.55, 0.56, 0.57), (0.42, 0.2, 0.14))))
    profile = [(0, -SUNK_M), (radius, -SUNK_M), (radius, height - 0.14), (1.25 * radius, height - 0.12)]
    profile += [(1.25 * radius, height - 0.08), (radius, height - 0.06), (0.6 * radius, height), (0, height)]
    return Model(kind="bollard", parts=(lathe(profile, metal, segments=20),))


def litter_bin(rng: np.random.Generator) -> Model:
    """Return a litter bin: a round or a square body under a lid."""
    height, radius = uniform(rng, 0.75, 0.95), uniform(rng, 0.2, 0.26)
    paint = plain(one_of(rng, ((0.15, 0.3, 0.2), (0.35, 0.36, 0.37), (0.75, 0.35, 0.1), (0.2, 0.2, 0.22))))
    if chance(rng, 0.5):
        body = cylinder(radius * 0.9, height + 0.05, paint, top_radius_m=radius).moved((0, 0, -0.05))
        lid = lathe([(0, 0), (radius + 0.03, 0), (radius + 0.02, 0.05), (0.1, 0.14), (0, 0.14)], _IRON)
        return Model(kind="litter_bin", parts=(body, lid.moved((0, 0, height))))
    parts = (
        rounded_box((1.8 * radius, 1.8 * radius, height + 0.05), paint, at=(0, 0, height / 2 - 0.025), radius_m=0.02),
        rounded_box((2.0 * radius, 2.0 * radius, 0.06), _IRON, at=(0, 0, height + 0.03), radius_m=0.02),
    )
    return Model(kind="litter_bin", parts=parts)


def wheeled_bin(rng: np.random.Generator) -> Model:
    """Return a dustbin on two wheels with a sloping lid."""
    paint = plain(one_of(rng, ((0.2, 0.22, 0.23), (0.12, 0.32, 0.18), (0.12, 0.22, 0.45), (0.7, 0.6, 0.15))))
    width, height = uniform(rng, 0.48, 0.6), uniform(rng, 0.88, 1.05)
    box = rounded_box((0.5, width, height - 0.1), paint, at=(0, 0, 0.05 + (height - 0.1) / 2), radius_m=0.03)
    body = warped(box, lambda v: v * (1, 1, 1) * np.stack([0.82 + 0.18 * v[:, 2] / height] * 2 + [np.ones(len(v))], 1))
    lid = rounded_box((0.56, width + 0.04, 0.05), paint, at=(0.0, 0, height), radius_m=0.02, rotation=about_y(0.08))
    handle = tube([(-0.31, -0.2, height), (-0.33, 0, height + 0.01), (-0.31, 0.2, height)], 0.018, _RUBBER)
    turn = about_x(np.pi / 2)
    wheels = tuple(
        cylinder(0.1, 0.05, _RUBBER, segments=20).moved((-0.2, side * (width / 2 - 0.04) + 0.025, 0.1), turn)
        for side in (-1, 1)
    )
    foot = rounded_box((0.08, width - 0.1, 0.08), _RUBBER, at=(0.14, 0, 0.03), radius_m=0.01)
    return Model(kind="wheeled_bin", parts=(body, lid, handle, foot, *wheels))


def hydrant(rng: np.random.Generator) -> Model:
    """Return a pillar hydrant with a bonnet and three nozzles."""
    paint = plain(one_of(rng, ((0.68, 0.12, 0.1), (0.8, 0.65, 0.12), (0.2, 0.35, 0.6))))
    height, radius = uniform(rng, 0.62, 0.85), uniform(rng, 0.1, 0.13)
    profile = [(0, -SUNK_M), (radius * 1.4, -SUNK_M), (radius * 1.4, 0.05), (radius, 0.08), (radius, height - 0.2)]
    profile += [(radius * 1.25, height - 0.18), (radius * 1.25, height - 0.14), (radius, height - 0.1)]
    profile += [(0.5 * radius, height - 0.02), (0.035, height), (0, height)]
    parts = [lathe(profile, paint, segments=20)]
    for turn in (0.0, np.pi / 2, -np.pi / 2):
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        at = np.array([0.0, 0.0, 0.62 * height])
        parts.append(tube([at, at + (radius + 0.03) * out, at + (radius + 0.07) * out], (0.05, 0.05, 0.055), paint))
    return Model(kind="hydrant", parts=tuple(parts))


def crate(rng: np.random.Generator) -> Model:
    x, y, z = uniform(rng, 0.4, 0.8), uniform(rng, 0.5, 1.0), uniform(rng, 0.35, 0.75)
    timber, slat = wood(rng, axis=1), wood(rng, axis=1)
    parts = [block((x, y, z), timber, at=(0, 0, z / 2))]
    levels = np.arange(0.08, z - 0.03, 0.17).tolist()
    parts += [block((x + 0.03, y + 0.03, 0.1), slat, at=(0, 0, level), radius_m=0.006) for level in levels]
    return Model(kind="crate", parts=tuple(parts))


def boulder(rng: np.random.Generator) -> Model:
    half = np.array([uniform(rng, 0.25, 0.55), uniform(rng, 0.25, 0.45), uniform(rng, 0.25, 0.4)])
    grey = uniform(rng, 0.4, 0.58)
    stone = Texture(
        pattern="speckle", first=(grey, grey, grey * 0.96), second=(grey * 0.75,) * 3, period_m=0.03, grain=0.35
    )
    body = rough(superellipsoid(half, (0.8, 0.8), stone), rng, 0.09, 0.6)
    return Model(kind="boulder", parts=(body.moved((0, 0, 0.35 * half[2])),))


def planter(rng: np.random.Generator) -> Model:
    size, height = uniform(rng, 0.55, 0.9), uniform(rng, 0.4, 0.6)
    grey, green = uniform(rng, 0.55, 0.7), uniform(rng, 0.25, 0.4)
    pot = rounded_box(
        (size, size, height), plain((grey, grey, grey * 0.97), grain=0.2), at=(0, 0, height / 2 - 0.02), radius_m=0.015
    )
    leaves = Texture(
        pattern="speckle", first=(0.5 * green, green, 0.35 * green), second=(0.8 * green, 1.3 * green, 0.5 * green),
        period_m=0.03, grain=0.5,
    )  # fmt: skip
    shrub = superellipsoid((0.44 * size, 0.44 * size, uniform(rng, 0.3, 0.45)), (0.7, 0.8), leaves)
    return Model(kind="planter", parts=(pot, rough(shrub, rng, 0.05, 0.3).moved((0, 0, height + 0.15))))


def sign_post(rng: np.random.Generator) -> Model:
    """Return a pole with a round or a square board across x."""
    height = uniform(rng, 2.1, 2.5)
    color = one_of(rng, ((0.75, 0.12, 0.12), (0.12, 0.25, 0.6), (0.85, 0.75, 0.2)))
    pole = tube([(0, 0, -SUNK_M), (0, 0, height / 2), (0, 0, height)], 0.035, plain((0.55, 0.56, 0.57)))
    face = Texture(pattern="checker", first=color, second=(0.9, 0.9, 0.88), period_m=0.31, grain=0.05)
    if chance(rng, 0.5):
        board = cylinder(0.3, 0.02, face, segments=28).moved((0.04, 0, height - 0.32), about_y(np.pi / 2))
    else:
        board = block((0.02, 0.55, 0.55), face, at=(0.05, 0, height - 0.3))
    return Model(kind="sign_post", parts=(pole, board))


def junction_box(rng: np.random.Generator) -> Model:
    """Return a cabinet of the telephone or the power company on a plinth."""
    width, height, depth = uniform(rng, 0.6, 1.2), uniform(rng, 0.85, 1.25), uniform(rng, 0.3, 0.42)
    paint = plain(one_of(rng, ((0.6, 0.62, 0.58), (0.32, 0.4, 0.34), (0.7, 0.68, 0.6))))
    parts = (
        rounded_box((depth, width, height), paint, at=(0, 0, height / 2), radius_m=0.012),
        rounded_box((depth + 0.05, width + 0.05, 0.2), plain((0.5, 0.5, 0.5)), at=(0, 0, 0.0), radius_m=0.01),
        rounded_box((depth + 0.06, width + 0.06, 0.05), paint, at=(0, 0, height), radius_m=0.015),
    )
    return Model(kind="junction_box", parts=parts)


def _across(outline_m: NDArray[np.float64], width: float, texture: Texture, *, taper: float) -> Part:
    middle = outline_m.mean(axis=0)
    ys = np.array([-0.5, -0.46, -0.3, 0.3, 0.46, 0.5]) * width
    scale = (1 - taper, 1 - 0.3 * taper, 1.0, 1.0, 1 - 0.3 * taper, 1 - taper)
    drawn = sweep(outline_m - middle, [(0.0, 0.0, y) for y in ys], texture, scale=scale)
    return warped(drawn, lambda v: v @ _XZ_FROM_SWEPT.T).moved((middle[0], 0.0, middle[1]))


# `sweep` along z puts an outline's x along -y, and its y along x.
_XZ_FROM_SWEPT = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def _paint(rng: np.random.Generator) -> Texture:
    base = _PAINTS[int(rng.integers(len(_PAINTS)))]
    return Texture(pattern="plain", first=base, second=base, period_m=0.5, grain=0.02, gloss=0.25)


def _bark(rng: np.random.Generator) -> Texture:
    tone = uniform(rng, 0.26, 0.42)
    return Texture(
        pattern="marble", first=(tone, tone * 0.8, tone * 0.62), second=(tone * 0.55, tone * 0.44, tone * 0.36),
        period_m=0.09, axis=0, grain=0.5,
    )  # fmt: skip
