"""Small things of random shape, massive or soft, 4 to 50 cm: one function per recipe, each standing on its base."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Part, Surface, lathe
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import about_x, about_y, about_z, chance, count, log_uniform, one_of, uniform
from tools.worlds.clutter.objects.cloths import crumpled
from tools.worlds.clutter.objects.materials import Skin
from tools.worlds.clutter.objects.solids import block, cylinder, grounded, prism, rough, superellipsoid, torus, warped


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
    depth, height, thick = uniform(rng, 0.1, 0.22), uniform(rng, 0.15, 0.32), log_uniform(rng, 0.003, 0.06)
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
    # Radii of 0.15..1 with the greatest 1.
    knots = rng.uniform(0.25, 1.0, size=count(rng, 3, 5))
    radii = np.interp(np.linspace(0, len(knots) - 1, points), np.arange(len(knots)), knots)
    radii = np.convolve(np.pad(radii, 1, mode="edge"), (0.25, 0.5, 0.25), mode="valid")
    return np.asarray(np.maximum(radii / radii.max(), 0.15))


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
    if chance(rng, 0.6):
        quarter = np.pi / 2 * rng.integers(4, size=3)
        return np.asarray(about_z(quarter[0]) @ about_x(quarter[1]) @ about_y(quarter[2]))
    a, b, c = rng.uniform(0, 2 * np.pi, size=3)
    return np.asarray(about_z(a) @ about_x(b) @ about_y(c))


def ring(rng: np.random.Generator, skin: Skin) -> Model:
    radius = log_uniform(rng, 0.03, 0.14)
    part = torus(radius, radius * uniform(rng, 0.1, 0.45), skin(rng), flat=uniform(rng, 0.6, 1.4))
    if chance(rng, 0.3):
        part = part.moved((0, 0, 0), about_x(np.pi / 2))
    return grounded("ring", [part])


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


def paper_pile(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a magazine, a notebook or a low pile of sheets: flat, 4 to 40 mm."""
    x, y, z = uniform(rng, 0.12, 0.3), uniform(rng, 0.1, 0.22), log_uniform(rng, 0.004, 0.04)
    return grounded("paper_pile", [block((x, y, z), skin(rng), radius_m=0.001)])


def star_prism(rng: np.random.Generator, skin: Skin) -> Model:
    teeth, radius = count(rng, 3, 8), log_uniform(rng, 0.04, 0.12)
    turn = 2 * np.pi * np.arange(2 * teeth) / (2 * teeth)
    reach = radius * np.where(np.arange(2 * teeth) % 2 == 0, 1.0, uniform(rng, 0.4, 0.8))
    outline = np.stack([reach * np.cos(turn), reach * np.sin(turn)], axis=1)
    return grounded("star_prism", [prism(outline, log_uniform(rng, 0.02, 0.25), skin(rng))])


def wedge(rng: np.random.Generator, skin: Skin) -> Model:
    x, z, ridge = uniform(rng, 0.06, 0.25), uniform(rng, 0.04, 0.18), uniform(rng, 0.0, 1.0)
    outline = np.array([[0, 0], [x, 0], [x * (0.05 + 0.9 * ridge), z], [x * (0.05 + 0.9 * ridge) - 0.01, z]])
    part = prism(outline, uniform(rng, 0.06, 0.3), skin(rng))
    return grounded("wedge", [part.moved((0, 0, 0), about_x(np.pi / 2))])


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


SMALL_SOLIDS: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f for f in (
        carton, book, tin, turned, blob, superquadric, composed, ring, tool, device, framed, paper_pile, star_prism,
        wedge, ribbed_pack,
    )
}  # fmt: skip
"""The recipes of massive small things by name."""


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


SMALL_SOFT: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f for f in (pouch, folded_cloth, crumpled_cloth)
}
"""The recipes of soft small things by name."""
