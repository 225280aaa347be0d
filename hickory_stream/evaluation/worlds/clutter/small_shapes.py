"""Small things of random shape, 4 to 45 cm: one function per recipe, each standing on its base, about the origin."""

from __future__ import annotations

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
from hickory_stream.evaluation.worlds.clutter.solids import (
    block,
    cylinder,
    grounded,
    prism,
    rough,
    sheet,
    superellipsoid,
    sweep,
    torus,
    warped,
)
from hickory_stream.evaluation.worlds.parts import Model, Part, Surface, lathe, tube

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.evaluation.worlds.clutter.materials import Skin
    from hickory_stream.evaluation.worlds.textures import Texture


def carton(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a closed box of any proportions, at times with a strip of tape or a label."""
    size = np.array([log_uniform(rng, 0.05, 0.4) for _ in range(3)])
    size[2] = min(size[2], 2.5 * size[:2].min())
    cover = skin(rng)
    parts = [block(size, cover, at=(0, 0, size[2] / 2), radius_m=uniform(rng, 0.001, 0.006))]
    if chance(rng, 0.4):
        parts.append(block((size[0] * 0.16, size[1] - 0.01, 0.0016), skin(rng), at=(0, 0, size[2] + 0.0004)))
    if chance(rng, 0.4):
        height, width = size[2] * uniform(rng, 0.3, 0.7), size[1] * uniform(rng, 0.3, 0.8)
        parts.append(block((0.0016, width, height), skin(rng), at=(size[0] / 2 + 0.0004, 0, size[2] / 2)))
    top = Surface(center_m=(0.0, 0.0, float(size[2]) + 0.0013), half_m=(float(size[0]) / 2, float(size[1]) / 2))
    return Model(kind="carton", parts=tuple(parts), surfaces=(top,))


def book(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a standing book, its back towards +x: two covers, a back and the leaves between them."""
    depth, height, thick = uniform(rng, 0.1, 0.22), uniform(rng, 0.15, 0.32), log_uniform(rng, 0.008, 0.06)
    cover, leaf = skin(rng), skin(rng)
    board = min(0.003, 0.2 * thick)
    parts = [
        block((depth - 0.006, thick - 2 * board + 0.0004, height - 0.008), leaf, at=(0, 0, height / 2)),
        block((0.003, thick, height), cover, at=(depth / 2 - 0.0015, 0, height / 2), radius_m=0.001),
    ]
    parts += [
        block((depth, board, height), cover, at=(0, s * (thick - board) / 2, height / 2), radius_m=0.0008)
        for s in (-1, 1)
    ]
    return grounded("book", parts)


def tin(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a tin or a tub: a cylinder, at times conical, with a lid or rims."""
    radius, height = log_uniform(rng, 0.02, 0.12), log_uniform(rng, 0.03, 0.3)
    top = radius * uniform(rng, 0.75, 1.25) if chance(rng, 0.4) else radius
    parts = [cylinder(radius, height, skin(rng), top_radius_m=top)]
    if chance(rng, 0.6):
        rim = skin(rng)
        lip = uniform(rng, 0.001, 0.004)
        parts += [cylinder(top + lip, min(0.03, 0.15 * height), rim, at=(0, 0, height - 0.002))]
    return grounded("tin", parts)


def turned(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a closed solid of revolution with a random smooth profile: bottles, vases, skittles, knobs."""
    height, widest = log_uniform(rng, 0.05, 0.4), log_uniform(rng, 0.02, 0.09)
    radii = widest * _smooth_profile(rng, 12)
    profile = [(0.0, 0.0)]
    profile += [(float(r), float(z)) for r, z in zip(radii, np.linspace(0, height, len(radii)), strict=True)]
    profile.append((0.0, height))
    parts = [lathe(profile, skin(rng), segments=28)]
    if chance(rng, 0.4):
        cap = float(radii[-1]) * 1.1 + 0.003
        parts.append(cylinder(cap, log_uniform(rng, 0.008, 0.04), skin(rng), at=(0, 0, height - 0.003)))
    return grounded("turned", parts)


def _smooth_profile(rng: np.random.Generator, points: int) -> NDArray[np.float64]:
    """Return radii of 0.15..1 with the greatest 1, smooth along a profile."""
    knots = rng.uniform(0.25, 1.0, size=count(rng, 3, 5))
    radii = np.interp(np.linspace(0, len(knots) - 1, points), np.arange(len(knots)), knots)
    radii = np.convolve(np.pad(radii, 1, mode="edge"), (0.25, 0.5, 0.25), mode="valid")
    return np.asarray(np.maximum(radii / radii.max(), 0.15))


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


def blob(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a lump without edges: fruit, stones, soft toys."""
    semi = log_uniform(rng, 0.025, 0.14) * rng.uniform(0.7, 1.3, size=3)
    part = superellipsoid(semi, (uniform(rng, 0.7, 1.2), uniform(rng, 0.7, 1.2)), skin(rng))
    return grounded("blob", [rough(part, rng, 0.12 * float(semi.min()), float(semi.max()) * 2)])


def superquadric(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a superellipsoid between box, cylinder, ellipsoid and diamond."""
    semi = [log_uniform(rng, 0.02, 0.15) for _ in range(3)]
    exponents = (uniform(rng, 0.1, 1.4), uniform(rng, 0.1, 1.4))
    return grounded("superquadric", [superellipsoid(semi, exponents, skin(rng))])


def composed(rng: np.random.Generator, skin: Skin) -> Model:
    """Return two to six primitives grown onto one another at random: tools, toys, devices."""
    size = log_uniform(rng, 0.025, 0.1)
    skins = [skin(rng) for _ in range(count(rng, 1, 3))]
    parts = [_primitive(rng, size, one_of(rng, skins))]
    for _ in range(count(rng, 1, 5)):
        host = one_of(rng, parts).vertices
        anchor = host[int(rng.integers(len(host)))] * 0.9 + host.mean(axis=0) * 0.1
        part = _primitive(rng, size * uniform(rng, 0.4, 1.0), one_of(rng, skins))
        parts.append(part.moved(anchor, _any_turn(rng)))
    return grounded("composed", parts)


def _primitive(rng: np.random.Generator, size: float, texture: Texture) -> Part:
    """Return a box, cylinder, cone, ball or bar of about a size, about the origin."""
    a, b, c = size * rng.uniform(0.4, 1.6, size=3)
    kind = int(rng.integers(5))
    if kind == 0:
        return block((a, b, c), texture, radius_m=uniform(rng, 0.001, 0.3 * size))
    if kind == 1:
        return cylinder(a / 2, c, texture, segments=20, at=(0, 0, -c / 2))
    if kind == 2:
        return cylinder(a / 2, c, texture, top_radius_m=a * uniform(rng, 0.0, 0.3), segments=20, at=(0, 0, -c / 2))
    if kind == 3:
        return superellipsoid((a / 2, b / 2, c / 2), (1.0, 1.0), texture, rings=11, around=18)
    return cylinder(0.15 * a, 1.6 * c, texture, segments=12, at=(0, 0, -0.8 * c))


def _any_turn(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a rotation: along the axes mostly, as things are made, else free."""
    if chance(rng, 0.6):
        quarter = np.pi / 2 * rng.integers(4, size=3)
        return np.asarray(about_z(quarter[0]) @ about_x(quarter[1]) @ about_y(quarter[2]))
    a, b, c = rng.uniform(0, 2 * np.pi, size=3)
    return np.asarray(about_z(a) @ about_x(b) @ about_y(c))


def ring(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a ring: lying, or standing on its rim."""
    radius = log_uniform(rng, 0.03, 0.14)
    part = torus(radius, radius * uniform(rng, 0.1, 0.45), skin(rng), flat=uniform(rng, 0.6, 1.4))
    if chance(rng, 0.3):
        part = part.moved((0, 0, 0), about_x(np.pi / 2))
    return grounded("ring", [part])


def tray(rng: np.random.Generator, skin: Skin) -> Model:
    """Return an open box: low as a tray or high as a bin, with walls that are straight or lean out."""
    x, y, z = log_uniform(rng, 0.1, 0.4), log_uniform(rng, 0.1, 0.4), log_uniform(rng, 0.02, 0.2)
    return open_box("tray", (x, y, z), uniform(rng, 0.003, 0.008), skin(rng), lean=uniform(rng, 0.0, 0.2))


def open_box(kind: str, size: tuple[float, float, float], wall: float, texture: Texture, lean: float = 0.0) -> Model:
    """Return a floor with four walls, which lean outwards; the floor inside is a surface."""
    x, y, z = size
    parts = [block((x, y, wall), texture, at=(0, 0, wall / 2), radius_m=0.001)]
    for sign in (-1, 1):
        parts.append(block((wall, y, z), texture, at=(sign * (x - wall) / 2, 0, z / 2), radius_m=0.001))
        parts.append(block((x, wall, z), texture, at=(0, sign * (y - wall) / 2, z / 2), radius_m=0.001))

    def leaning(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(vertices * (1, 1, 1) + vertices * (1, 1, 0) * lean * vertices[:, 2:] / z)

    floor = Surface(center_m=(0.0, 0.0, wall), half_m=(x / 2 - wall - 0.005, y / 2 - wall - 0.005), headroom_m=3 * z)
    return Model(kind=kind, parts=tuple(warped(part, leaning) for part in parts), surfaces=(floor,))


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


def pouch(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a filled bag: slack, wider below, creased, its neck drawn together or folded."""
    semi = log_uniform(rng, 0.05, 0.18) * rng.uniform(0.7, 1.3, size=3)
    part = superellipsoid(semi, (uniform(rng, 0.5, 0.9), uniform(rng, 0.4, 0.9)), skin(rng), rings=21)
    pinch, sag = uniform(rng, 0.0, 0.6), uniform(rng, 0.0, 0.3)

    def slack(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        height = vertices[:, 2:] / semi[2]
        width = 1.0 + sag * (-height) - pinch * np.maximum(height, 0.0) ** 2
        return np.asarray(vertices * (1, 1, 0) * width + vertices * (0, 0, 1) * np.where(height < 0, 0.75, 1.0))

    return grounded("bag", [rough(warped(part, slack), rng, 0.06 * float(semi.min()), float(semi.min()))])


def folded_cloth(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a folded towel or garment: a few soft layers."""
    x, y, layer = uniform(rng, 0.15, 0.4), uniform(rng, 0.15, 0.4), uniform(rng, 0.012, 0.035)
    stuff, z, parts = skin(rng), 0.0, []
    for _ in range(count(rng, 1, 5)):
        part = superellipsoid((x / 2, y / 2, layer / 2), (0.4, 0.15), stuff, rings=11, around=32)
        shift = rng.normal(0, 0.006, size=2)
        parts.append(rough(part, rng, 0.005, 0.15).moved((*shift, z)))
        z += layer * 0.9
    return grounded("folded_cloth", parts)


def crumpled_cloth(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a cloth that lies crumpled: a wavy sheet, higher in the middle."""
    size, height = uniform(rng, 0.15, 0.5), uniform(rng, 0.03, 0.15)
    return grounded("crumpled_cloth", [crumpled(rng, (size, size * uniform(rng, 0.6, 1.0)), height, skin(rng))])


def crumpled(rng: np.random.Generator, size: tuple[float, float], height: float, texture: Texture) -> Part:
    """Return a wavy sheet that is flat at its irregular border and up to `height` high within it."""
    grid = 26
    s, t = np.meshgrid(np.linspace(-1, 1, grid), np.linspace(-1, 1, grid), indexing="ij")
    # A square that is pressed towards a disc, its border frayed.
    angle = np.arctan2(t, s)
    fray = 1.0 + 0.12 * np.sin(3 * angle + rng.uniform(0, 6.3)) + 0.08 * np.sin(5 * angle + rng.uniform(0, 6.3))
    waves = np.zeros_like(s)
    for _ in range(7):
        k = rng.normal(0, 4.0, size=2)
        waves += np.abs(np.sin(k[0] * s + k[1] * t + rng.uniform(0, 6.3)))
    window = np.clip((1 - s**4) * (1 - t**4), 0.0, 1.0) ** 0.5
    z = height * window * (0.25 + 0.75 * waves / waves.max())
    points = np.stack([s * fray * size[0] / 2, t * fray * size[1] / 2, z + 0.003], axis=-1)
    return sheet(points, 0.003, texture)


def bent_bar(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a bar that is bent along a curve: handles, hooks, cables, pipes."""
    length, thick = log_uniform(rng, 0.1, 0.5), log_uniform(rng, 0.004, 0.02)
    turn = np.cumsum(rng.normal(0, 0.25, size=16)) * uniform(rng, 0.0, 2.0)
    steps = np.stack([np.cos(turn), np.sin(turn), np.zeros(16)], axis=1) * length / 16
    path = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    corners = one_of(rng, (4, 6, 12))
    return grounded("bent_bar", [sweep(regular(corners, thick), path, skin(rng))])


def regular(corners: int, radius: float) -> NDArray[np.float64]:
    """Return a regular (K, 2) outline, counter-clockwise."""
    turn = 2 * np.pi * (np.arange(corners) + 0.5) / corners
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)


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


def tool(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a lying handle with a head: hammers, brushes, spatulas, rackets."""
    length, thick = uniform(rng, 0.1, 0.35), uniform(rng, 0.006, 0.018)
    handle = cylinder(thick, length, skin(rng), top_radius_m=thick * uniform(rng, 0.6, 1.2), segments=12)
    head = _primitive(rng, uniform(rng, 0.03, 0.1), skin(rng)).moved((0, 0, length))
    return grounded("tool", [part.moved((0, 0, 0), about_y(np.pi / 2)) for part in (handle, head)])


def device(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a flat or upright case with a raised field, knobs or keys on its front at +x."""
    x, y, z = log_uniform(rng, 0.02, 0.2), log_uniform(rng, 0.06, 0.4), log_uniform(rng, 0.04, 0.3)
    parts = [block((x, y, z), skin(rng), at=(0, 0, z / 2), radius_m=uniform(rng, 0.002, 0.02))]
    parts.append(
        block((0.004, y * uniform(rng, 0.3, 0.9), z * uniform(rng, 0.3, 0.7)), skin(rng), at=(x / 2, 0, z * 0.55))
    )
    knob, radius = skin(rng), uniform(rng, 0.004, 0.015)
    for i in range(count(rng, 0, 4)):
        stud = cylinder(radius, 0.012, knob, segments=12).moved((0, 0, 0), about_y(np.pi / 2))
        parts.append(stud.moved((x / 2 - 0.001, (i - 1.5) * y / 5, z * 0.12 + radius)))
    if chance(rng, 0.3):
        parts.append(block((x * 0.5, y * 0.4, 0.02), skin(rng), at=(0, 0, -0.008)))
    return grounded("device", parts)


def framed(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a thin upright panel in a frame, leaning back on a strut: pictures, screens, mirrors."""
    y, z, bar = log_uniform(rng, 0.1, 0.45), log_uniform(rng, 0.1, 0.4), uniform(rng, 0.008, 0.03)
    frame = skin(rng)
    parts = [block((0.006, y - bar, z - bar), skin(rng), at=(0, 0, z / 2))]
    for s in (-1, 1):
        parts.append(block((0.014, bar, z), frame, at=(0, s * (y - bar) / 2, z / 2)))
        parts.append(block((0.014, y, bar), frame, at=(0, 0, z / 2 + s * (z - bar) / 2)))
    lean = about_y(-uniform(rng, 0.05, 0.3))
    parts = [part.moved((0, 0, 0), lean) for part in parts]
    parts.append(block((0.01, 0.03, 0.75 * z), frame, at=(-0.2 * z, 0, 0.36 * z), rotation=about_y(0.25)))
    return grounded("framed", parts)


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


def paper_pile(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a magazine, a notebook or a low pile of sheets: flat, 4 to 40 mm."""
    x, y, z = uniform(rng, 0.12, 0.3), uniform(rng, 0.1, 0.22), log_uniform(rng, 0.004, 0.04)
    return grounded("paper_pile", [block((x, y, z), skin(rng), radius_m=0.001)])


def goblet(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a hollow cup on a stem."""
    rim, height, stem = uniform(rng, 0.03, 0.06), uniform(rng, 0.12, 0.24), uniform(rng, 0.004, 0.008)
    low = height * uniform(rng, 0.35, 0.6)
    profile = [(0, 0), (rim * 0.9, 0), (rim * 0.85, 0.006), (stem, 0.012), (stem, low), (rim, (low + height) / 2)]
    profile += [(rim * 0.85, height), (rim * 0.85 - 0.003, height), (rim - 0.003, (low + height) / 2), (0, low + 0.01)]
    return grounded("goblet", [lathe(profile, skin(rng))])


def star_prism(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a prism over a star or a cross."""
    teeth, radius = count(rng, 3, 8), log_uniform(rng, 0.04, 0.12)
    turn = 2 * np.pi * np.arange(2 * teeth) / (2 * teeth)
    reach = radius * np.where(np.arange(2 * teeth) % 2 == 0, 1.0, uniform(rng, 0.4, 0.8))
    outline = np.stack([reach * np.cos(turn), reach * np.sin(turn)], axis=1)
    return grounded("star_prism", [prism(outline, log_uniform(rng, 0.02, 0.25), skin(rng))])


def wedge(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a lying wedge or roof."""
    x, z, ridge = uniform(rng, 0.06, 0.25), uniform(rng, 0.04, 0.18), uniform(rng, 0.0, 1.0)
    outline = np.array([[0, 0], [x, 0], [x * (0.05 + 0.9 * ridge), z], [x * (0.05 + 0.9 * ridge) - 0.01, z]])
    part = prism(outline, uniform(rng, 0.06, 0.3), skin(rng))
    return grounded("wedge", [part.moved((0, 0, 0), about_x(np.pi / 2))])


def spool(rng: np.random.Generator, skin: Skin) -> Model:
    """Return two discs joined by a core: spools, dumb-bells, yo-yos, standing or lying."""
    disc, core, length = uniform(rng, 0.03, 0.11), uniform(rng, 0.2, 0.7), uniform(rng, 0.06, 0.25)
    edge, outer = length * uniform(rng, 0.06, 0.25), skin(rng)
    parts = [
        cylinder(disc, edge, outer),
        cylinder(disc, edge, outer, at=(0, 0, length - edge)),
        cylinder(disc * core, length - edge, skin(rng), at=(0, 0, edge / 2)),
    ]
    turn = about_y(np.pi / 2) if chance(rng, 0.5) else np.eye(3)
    return grounded("spool", [part.moved((0, 0, 0), turn) for part in parts])


def lattice_cube(rng: np.random.Generator, skin: Skin) -> Model:
    """Return the edges of a box as bars, at times with bars within: cages, stands, lanterns."""
    size = [log_uniform(rng, 0.08, 0.35) for _ in range(3)]
    bar, metal = uniform(rng, 0.004, 0.014), skin(rng)
    parts = []
    for axis in range(3):
        i, j = (axis + 1) % 3, (axis + 2) % 3
        extra = one_of(rng, ((), (), (0.0,), (-0.17, 0.17)))
        for a in (-0.5, 0.5):
            for b in (-0.5, 0.5, *extra):
                at, extent = np.zeros(3), np.full(3, bar)
                at[i], at[j], extent[axis] = a * size[i], b * size[j], size[axis] + bar
                parts.append(block(extent, metal, at=at, radius_m=0.001))
    return grounded("lattice_cube", parts)


def coil(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a rope or hose in windings that lie on one another."""
    radius, bar, windings = uniform(rng, 0.05, 0.16), uniform(rng, 0.005, 0.014), uniform(rng, 2, 5)
    turn = np.linspace(0, 2 * np.pi * windings, int(24 * windings))
    reach = radius * (1 - 0.06 * np.sin(0.37 * turn))
    path = np.stack([reach * np.cos(turn), reach * np.sin(turn), bar * 1.9 * turn / (2 * np.pi)], axis=1)
    return grounded("coil", [sweep(regular(8, bar), path, skin(rng))])


def arch(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a bent strip that stands on its two ends: clips, tunnels, saddles."""
    radius, width, thick = uniform(rng, 0.04, 0.14), uniform(rng, 0.04, 0.2), uniform(rng, 0.008, 0.03)
    turn = np.linspace(0, np.pi, 15)
    path = np.stack([radius * np.cos(turn), np.zeros(15), radius * uniform(rng, 0.6, 1.5) * np.sin(turn)], axis=1)
    # The carried frame has its first axis in the plane of the path.
    outline = np.array([[-thick, -width], [thick, -width], [thick, width], [-thick, width]]) / 2
    return grounded("arch", [sweep(outline, path, skin(rng))])


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
    """Return the four sides of a level rectangle as bars."""
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


def ribbed_pack(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a pack of equal pieces under one wrapping: a box with rounded ribs."""
    pieces, x, y, z = count(rng, 2, 6), uniform(rng, 0.06, 0.2), uniform(rng, 0.03, 0.08), uniform(rng, 0.06, 0.25)
    wrap = skin(rng)
    parts = [
        block((x, y * 1.04, z), wrap, at=(0, (i - (pieces - 1) / 2) * y, z / 2), radius_m=0.3 * y)
        for i in range(pieces)
    ]
    parts.append(block((x * 1.01, y * pieces * 0.8, z * 0.4), skin(rng), at=(0, 0, z / 2)))
    top = Surface(center_m=(0.0, 0.0, z), half_m=(x / 2, y * pieces / 2))
    return Model(kind="ribbed_pack", parts=tuple(parts), surfaces=(top,))


def binder(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a standing binder or magazine holder, open behind and above."""
    x, y, z, wall = uniform(rng, 0.2, 0.3), uniform(rng, 0.05, 0.11), uniform(rng, 0.22, 0.34), 0.004
    cover = skin(rng)
    parts = [block((wall, y, z), cover, at=((x - wall) / 2, 0, z / 2)), block((x, y, wall), cover, at=(0, 0, wall / 2))]
    parts += [block((x, wall, z), cover, at=(0, s * (y - wall) / 2, z / 2)) for s in (-1, 1)]
    parts.append(block((x * 0.9, y * uniform(rng, 0.3, 0.85), z * 0.92), skin(rng), at=(-0.01, 0, z * 0.46 + wall)))
    return grounded("binder", parts)


def lidded_case(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a case with a lid that stands out and grips at its ends."""
    x, y, z = uniform(rng, 0.1, 0.45), uniform(rng, 0.12, 0.5), uniform(rng, 0.06, 0.3)
    lid, lip = z * uniform(rng, 0.12, 0.35), uniform(rng, 0.004, 0.015)
    cover = skin(rng)
    parts = [
        block((x, y, z - lid / 2), skin(rng), at=(0, 0, (z - lid / 2) / 2)),
        block((x + 2 * lip, y + 2 * lip, lid), cover, at=(0, 0, z - lid / 2), radius_m=0.006),
    ]
    parts += [block((0.3 * x, 0.02, 0.02), cover, at=(0, s * (y / 2 + 0.008), 0.5 * z)) for s in (-1, 1)]
    top = Surface(center_m=(0.0, 0.0, z), half_m=(x / 2, y / 2))
    return Model(kind="lidded_case", parts=tuple(parts), surfaces=(top,))


def slab(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a flat piece with rounded corners: tablets, boards, bars."""
    semi = (uniform(rng, 0.06, 0.18), uniform(rng, 0.04, 0.14), uniform(rng, 0.005, 0.025))
    part = superellipsoid(semi, (0.15, uniform(rng, 0.15, 0.6)), skin(rng))
    top = Surface(center_m=(0.0, 0.0, 2 * semi[2]), half_m=(0.7 * semi[0], 0.7 * semi[1]))
    return Model(kind="slab", parts=grounded("slab", [part]).parts, surfaces=(top,))


def grating(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a perforated plate, bars across bars, upright on two feet or lying."""
    y, z, pitch = uniform(rng, 0.12, 0.4), uniform(rng, 0.12, 0.35), uniform(rng, 0.02, 0.05)
    bar, metal = pitch * uniform(rng, 0.15, 0.5), skin(rng)
    parts = [block((0.006, bar, z), metal, at=(0, v, z / 2), radius_m=0.001) for v in np.arange(-y / 2, y / 2, pitch)]
    parts += [block((0.006, y, bar), metal, at=(0, 0, h), radius_m=0.001) for h in np.arange(bar, z, pitch)]
    if chance(rng, 0.5):
        return grounded("grating", [part.moved((0, 0, 0), about_y(np.pi / 2)) for part in parts])
    parts += [block((0.08, 0.02, 0.012), metal, at=(0, s * 0.35 * y, 0.006)) for s in (-1, 1)]
    return grounded("grating", parts)


SMALL_SHAPES: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f
    for f in (
        carton, book, tin, turned, open_vessel, blob, superquadric, composed, ring, tray, crate, pouch, folded_cloth,
        crumpled_cloth, bent_bar, wire_rack, tool, device, framed, sprig, paper_pile, goblet, star_prism, wedge, spool,
        lattice_cube, coil, arch, wire_basket, sleeve, bent_panel, ribbed_pack, binder, lidded_case, slab, grating,
    )
}  # fmt: skip
"""The recipes of small things by name."""
