"""Other large objects on the floor, of random make: one function per recipe; fronts look along +x."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hickory_stream.worlds.furniture import vessel
from hickory_stream.worlds.object_models import Model, Surface, lathe, tube
from tools.worlds.clutter.draws import about_x, about_y, about_z, chance, count, log_uniform, one_of, uniform
from tools.worlds.clutter.objects.cloths import crumpled
from tools.worlds.clutter.objects.materials import Skin
from tools.worlds.clutter.objects.solids import (
    block,
    cylinder,
    grounded,
    open_box,
    regular,
    rough,
    superellipsoid,
    sweep,
    torus,
)


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


def ladder(rng: np.random.Generator, skin: Skin) -> Model:
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


BODIES: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f for f in (
        big_carton, open_carton, barrel, sack, roll, floor_lamp, foliage, screen, ladder, draped, blanket_heap,
        rounded_body, machine,
    )
}  # fmt: skip
"""The recipes of bodies by name."""
