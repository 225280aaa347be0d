"""Small hollow, thin, bent and perforated things, 4 to 50 cm: one function per recipe, each standing on its base."""

from collections.abc import Callable

import numpy as np

from hickory_stream.worlds.object_models import Model, Part, Surface, lathe, tube
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import about_x, about_y, about_z, chance, count, log_uniform, one_of, uniform
from tools.worlds.clutter.objects.materials import Skin
from tools.worlds.clutter.objects.solids import (
    block,
    cylinder,
    grounded,
    open_box,
    regular,
    sheet,
    superellipsoid,
    sweep,
    torus,
)


def open_vessel(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a cup, bowl, pot or bucket: a hollow solid of revolution, at times with a handle or two."""
    rim, height = log_uniform(rng, 0.03, 0.16), log_uniform(rng, 0.03, 0.22)
    foot, wall = rim * uniform(rng, 0.4, 1.05), uniform(rng, 0.003, 0.008)
    share = np.linspace(0, 1, 6)
    bulge = uniform(rng, 0.5, 2.2)
    radii = foot + (rim - foot) * share ** (1 / bulge)
    outside = [(float(r), float(z)) for r, z in zip(radii, share * height, strict=True)]
    inside = [(max(r - wall, 0.002), max(z, 1.5 * wall)) for r, z in reversed(outside)]
    floor = (0.0, inside[-1][1])
    clay = skin(rng)
    parts = [lathe([(0.0, 0.0), *outside, *inside, floor], clay, segments=30)]
    for side in range(one_of(rng, (0, 0, 1, 1, 2))):
        reach, turn = uniform(rng, 0.3, 0.6) * height, np.linspace(-1.5, 1.5, 8)
        middle = (1 - 2 * side) * (float(np.interp(0.55, share, radii)) - wall)
        path = [
            (0.0, middle + (1 - 2 * side) * reach * 0.6 * np.cos(a), 0.55 * height + reach * np.sin(a) * 0.7)
            for a in turn
        ]
        parts.append(tube(path, uniform(rng, 0.003, 0.008), clay, segments=8))
    return grounded("vessel", parts)


def tray(rng: np.random.Generator, skin: Skin) -> Model:
    """Return an open box: low as a tray or high as a bin, with walls that are straight or lean out."""
    x, y, z = log_uniform(rng, 0.1, 0.4), log_uniform(rng, 0.1, 0.4), log_uniform(rng, 0.02, 0.2)
    return open_box("tray", (x, y, z), uniform(rng, 0.003, 0.008), skin(rng), lean=uniform(rng, 0.0, 0.2))


def crate(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a crate of slats or bars: one looks through its walls."""
    x, y, z = uniform(rng, 0.2, 0.5), uniform(rng, 0.2, 0.4), uniform(rng, 0.12, 0.32)
    wood, thick = skin(rng), uniform(rng, 0.008, 0.016)
    parts = [block((x, y, thick), wood, at=(0, 0, thick / 2))]
    rows = count(rng, 2, 4)
    pitch = z / rows
    board = pitch * uniform(rng, 0.35, 0.75)
    for i in range(rows):
        h = (i + 1) * pitch - board / 2
        for s in (-1, 1):
            parts.append(block((thick, y, board), wood, at=(s * (x - thick) / 2, 0, h)))
            parts.append(block((x, thick, board), wood, at=(0, s * (y - thick) / 2, h)))
    for sx in (-1, 1):
        at = (sx * (x / 2 - 0.016), y / 2 - 0.016)
        parts += [block((0.02, 0.02, z), wood, at=(at[0], sy * at[1], z / 2)) for sy in (-1, 1)]
    floor = Surface(center_m=(0.0, 0.0, thick), half_m=(x / 2 - 0.04, y / 2 - 0.04), headroom_m=2.5 * z)
    return Model(kind="crate", parts=tuple(parts), surfaces=(floor,))


def bent_bar(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a bar that is bent along a curve: handles, hooks, cables, pipes."""
    length, thick = log_uniform(rng, 0.1, 0.5), log_uniform(rng, 0.004, 0.02)
    turn = np.cumsum(rng.normal(0, 0.25, size=16)) * uniform(rng, 0.0, 2.0)
    steps = np.stack([np.cos(turn), np.sin(turn), np.zeros(16)], axis=1) * length / 16
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    corners = one_of(rng, (4, 6, 12))
    return grounded("bent_bar", [sweep(regular(corners, thick), path, skin(rng))])


def wire_rack(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a grid of bars on feet or standing up: cooling racks, letter racks, grates."""
    x, y, pitch = uniform(rng, 0.12, 0.4), uniform(rng, 0.12, 0.35), uniform(rng, 0.015, 0.045)
    bar, metal, foot = uniform(rng, 0.0015, 0.004), skin(rng), uniform(rng, 0.01, 0.06)
    parts = [
        tube([(-x / 2, v, foot), (0, v, foot), (x / 2, v, foot)], bar, metal, segments=6)
        for v in np.arange(-y / 2, y / 2 + 1e-6, pitch)
    ]
    parts += [
        tube([(u, -y / 2, foot), (u, 0, foot), (u, y / 2, foot)], 1.3 * bar, metal, segments=6)
        for u in (-x / 2, 0, x / 2)
    ]
    parts += [
        cylinder(1.5 * bar, foot, metal, at=(sx * x / 2, sy * y / 2, 0), segments=8) for sx in (-1, 1) for sy in (-1, 1)
    ]
    if chance(rng, 0.4):
        parts = [part.moved((0, 0, 0), about_x(np.pi / 2)) for part in parts]
    return grounded("wire_rack", parts)


def sprig(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a vessel with thin stalks and leaves: pots of herbs, brushes in a cup."""
    radius, height = uniform(rng, 0.03, 0.08), uniform(rng, 0.05, 0.13)
    parts = [cylinder(radius * uniform(rng, 0.6, 1.0), height, skin(rng), top_radius_m=radius)]
    stalk, leaf, length = skin(rng), skin(rng), uniform(rng, 0.06, 0.25)
    is_leafy = chance(rng, 0.6)
    for _ in range(count(rng, 4, 10)):
        turn, lean = uniform(rng, 0, 6.3), uniform(rng, 0.0, 0.6)
        end = np.array([np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)]) * length
        start = np.array([0.4 * radius * np.cos(turn), 0.4 * radius * np.sin(turn), height - 0.01])
        parts.append(tube([start, start + end / 2, start + end], uniform(rng, 0.002, 0.005), stalk, segments=6))
        if is_leafy:
            broad = superellipsoid((length * 0.25, length * 0.12, 0.003), (1.0, 1.0), leaf, rings=7, around=12)
            parts.append(broad.moved(start + end, about_z(turn) @ about_y(uniform(rng, -0.5, 1.0))))
    return grounded("sprig", parts)


def goblet(rng: np.random.Generator, skin: Skin) -> Model:
    rim, height, stem = uniform(rng, 0.03, 0.06), uniform(rng, 0.12, 0.24), uniform(rng, 0.004, 0.008)
    low = height * uniform(rng, 0.35, 0.6)
    profile = [(0, 0), (rim * 0.9, 0), (rim * 0.85, 0.006), (stem, 0.012), (stem, low), (rim, (low + height) / 2)]
    profile += [(rim * 0.85, height), (rim * 0.85 - 0.003, height), (rim - 0.003, (low + height) / 2), (0, low + 0.01)]
    return grounded("goblet", [lathe(profile, skin(rng))])


def wire_basket(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a basket of wires or straps: one looks through all of its sides, and things lie in it."""
    x, y, z = uniform(rng, 0.15, 0.45), uniform(rng, 0.15, 0.45), uniform(rng, 0.08, 0.3)
    wire, metal, pitch = uniform(rng, 0.0015, 0.006), skin(rng), uniform(rng, 0.025, 0.07)
    lean = uniform(rng, 1.0, 1.2)
    parts = []
    for h in (*np.arange(wire, z - pitch / 2, pitch), z):
        grow = 1.0 + (lean - 1.0) * h / z
        parts += _frame((x * grow, y * grow), float(h), 1.4 * wire if h == z else wire, metal)
    for axis, (long, wide) in enumerate(((x, y), (y, x))):
        for at in np.arange(-long / 2 + pitch, long / 2 - pitch / 2, pitch):
            ends = [np.array([at, s * wide / 2]) for s in (-1, 1)]
            path = [[*(ends[0] * lean), z], [*ends[0], wire], [*(ends[0] + ends[1]) / 2, wire], [*ends[1], wire]]
            path.append([*(ends[1] * lean), z])
            turned = [p if axis == 0 else [p[1], p[0], p[2]] for p in path]
            parts.append(sweep(regular(5, wire), turned, metal))
    model = grounded("wire_basket", parts)
    floor = Surface(center_m=(0.0, 0.0, 2.5 * wire), half_m=(x / 2 - 0.02, y / 2 - 0.02), headroom_m=2 * z)
    return Model(kind=model.kind, parts=model.parts, surfaces=(floor,))


def _frame(size: tuple[float, float], z: float, wire: float, texture: Texture) -> list[Part]:
    x, y = size
    parts = [block((2 * wire, y, 2 * wire), texture, at=(s * x / 2, 0, z), radius_m=0.5 * wire) for s in (-1, 1)]
    parts += [block((x, 2 * wire, 2 * wire), texture, at=(0, s * y / 2, z), radius_m=0.5 * wire) for s in (-1, 1)]
    return parts


def sleeve(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a tube that is open at both ends, standing or lying: rolls, rings, pieces of pipe."""
    radius, height = log_uniform(rng, 0.025, 0.12), log_uniform(rng, 0.02, 0.35)
    wall = radius * uniform(rng, 0.08, 0.6)
    ring = torus(1.0, 0.5, skin(rng), segments=(32, 4))
    # The four corners of the section, from the ring's round one.
    section = np.array([[radius, height], [radius - wall, height], [radius - wall, 0.0], [radius, 0.0]])
    turn = np.arctan2(ring.vertices[:, 1], ring.vertices[:, 0])
    corner = section[np.arange(len(turn)) % 4]
    vertices = np.stack([np.cos(turn) * corner[:, 0], np.sin(turn) * corner[:, 0], corner[:, 1]], axis=1)
    part = Part(vertices=vertices, faces=ring.faces, texture=ring.texture)
    lies = about_x(np.pi / 2) if chance(rng, 0.4) else np.eye(3)
    return grounded("sleeve", [part.moved((0, 0, 0), lies)])


def bent_panel(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a thin panel bent about a line, standing on its rim or lying as a bridge: shells, folders, scales."""
    radius, width, turn = log_uniform(rng, 0.05, 0.25), uniform(rng, 0.08, 0.4), uniform(rng, 0.6, 2.8)
    s, t = np.meshgrid(np.linspace(-turn / 2, turn / 2, 15), np.linspace(-0.5, 0.5, 7), indexing="ij")
    points = np.stack([radius * np.sin(s), t * width, radius * np.cos(s)], axis=-1)
    part = sheet(points, uniform(rng, 0.003, 0.012), skin(rng))
    return grounded("bent_panel", [part.moved((0, 0, 0), about_x(np.pi / 2) if chance(rng, 0.5) else np.eye(3))])


def binder(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a standing binder or magazine holder, open behind and above."""
    x, y, z, wall = uniform(rng, 0.2, 0.3), uniform(rng, 0.05, 0.11), uniform(rng, 0.22, 0.34), 0.004
    cover = skin(rng)
    parts = [block((wall, y, z), cover, at=((x - wall) / 2, 0, z / 2)), block((x, y, wall), cover, at=(0, 0, wall / 2))]
    parts += [block((x, wall, z), cover, at=(0, s * (y - wall) / 2, z / 2)) for s in (-1, 1)]
    parts.append(block((x * 0.9, y * uniform(rng, 0.3, 0.85), z * 0.92), skin(rng), at=(-0.01, 0, z * 0.46 + wall)))
    return grounded("binder", parts)


SMALL_FRAMES: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f for f in (
        open_vessel, tray, crate, bent_bar, wire_rack, sprig, goblet, wire_basket, sleeve, bent_panel, binder,
    )
}  # fmt: skip
"""The recipes of hollow and open small things by name."""
