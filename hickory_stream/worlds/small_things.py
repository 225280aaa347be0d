"""Small objects that stand on furniture, on shelves or on one another: one function per kind."""

import numpy as np

from hickory_stream.worlds.furniture import vessel
from hickory_stream.worlds.object_models import Model, Part, Surface, lathe, rounded_box, tube
from hickory_stream.worlds.palettes import glaze, plain
from hickory_stream.worlds.textures import Color, Texture


def monitor(rng: np.random.Generator) -> Model:
    """Return a screen on a stand, its display towards +x."""
    width = float(rng.uniform(0.52, 0.62))
    height, dark = width * 0.58, plain((0.10, 0.10, 0.11))
    picture = Texture(pattern="checker", first=(0.18, 0.36, 0.58), second=(0.24, 0.46, 0.66), period_m=0.09, grain=0.03)
    center_z = 0.13 + height / 2
    parts = (
        rounded_box((0.035, width, height), dark, at=(0.0, 0.0, center_z), radius_m=0.01),
        rounded_box((0.004, width - 0.03, height - 0.03), picture, at=(0.018, 0.0, center_z), radius_m=0.001),
        rounded_box((0.03, 0.06, 0.28), dark, at=(-0.03, 0.0, 0.15)),
        rounded_box((0.18, 0.24, 0.014), dark, at=(-0.01, 0.0, 0.007)),
    )
    return Model(kind="monitor", parts=parts)


def box(rng: np.random.Generator) -> Model:
    """Return a closed parcel or a patterned storage box; another one can stand on it."""
    size = (float(rng.uniform(0.26, 0.40)), float(rng.uniform(0.32, 0.48)), float(rng.uniform(0.22, 0.34)))
    return _box(rng, size)


def small_box(rng: np.random.Generator) -> Model:
    """Return a box for a shelf or a table."""
    size = (float(rng.uniform(0.14, 0.18)), float(rng.uniform(0.18, 0.26)), float(rng.uniform(0.11, 0.16)))
    return _box(rng, size)


def _box(rng: np.random.Generator, size: tuple[float, float, float]) -> Model:
    cardboard = Texture(pattern="plain", first=(0.68, 0.52, 0.35), second=(0.62, 0.46, 0.30), period_m=0.05, grain=0.15)
    cover = cardboard if rng.random() < 0.5 else _storage_cover(rng)
    tape = plain((0.80, 0.74, 0.60))
    parts = (
        rounded_box(size, cover, at=(0.0, 0.0, size[2] / 2), radius_m=0.005),
        rounded_box((0.05, size[1] - 0.03, 0.002), tape, at=(0.0, 0.0, size[2] + 0.0005), radius_m=0.0008),
    )
    top = Surface(center_m=(0.0, 0.0, size[2] + 0.0015), half_m=(size[0] / 2, size[1] / 2))
    return Model(kind="box", parts=parts, surfaces=(top,))


def _storage_cover(rng: np.random.Generator) -> Texture:
    base = glaze(rng, "plain")
    light: Color = (0.5 + 0.5 * base.first[0], 0.5 + 0.5 * base.first[1], 0.5 + 0.5 * base.first[2])
    return Texture(pattern="checker", first=base.first, second=light, period_m=float(rng.uniform(0.05, 0.09)))


def mug(rng: np.random.Generator) -> Model:
    """Return a mug with a handle at +y."""
    radius, height = float(rng.uniform(0.040, 0.048)), float(rng.uniform(0.09, 0.11))
    ceramic = glaze(rng)
    turn = np.linspace(-np.pi / 2, np.pi / 2, 9)
    # The ends lie inside the wall, so that the handle is joined to the cup.
    path = [(0.0, radius - 0.002 + 0.030 * np.cos(a), height / 2 + 0.030 * np.sin(a)) for a in turn]
    return Model(kind="mug", parts=(vessel(radius * 0.92, radius, height, 0.004, ceramic), tube(path, 0.006, ceramic)))


def bottle(rng: np.random.Generator) -> Model:
    """Return a closed bottle with a label and a cap."""
    radius, height = float(rng.uniform(0.034, 0.042)), float(rng.uniform(0.24, 0.31))
    color: Color = ((0.12, 0.34, 0.18), (0.38, 0.20, 0.10), (0.55, 0.72, 0.78))[int(rng.integers(3))]
    shoulder = 0.62 * height
    body = [(0.0, 0.0), (radius, 0.0), (radius, shoulder / 2), (radius, shoulder), (0.8 * radius, shoulder + 0.03)]
    neck = [(0.014, 0.80 * height), (0.013, height - 0.02), (0.0, height - 0.02)]
    label = [(0.0, 0.25 * shoulder), (radius + 0.001, 0.25 * shoulder), (radius + 0.001, 0.8 * shoulder)]
    cap = [(0.0, height - 0.03), (0.016, height - 0.03), (0.016, height), (0.0, height)]
    parts = (
        lathe([*body, *neck], plain(color, grain=0.05)),
        lathe([*label, (0.0, 0.8 * shoulder)], glaze(rng)),
        lathe(cap, plain((0.85, 0.20, 0.18))),
    )
    return Model(kind="bottle", parts=parts)


def bowl(rng: np.random.Generator) -> Model:
    """Return an open bowl."""
    rim, height, skin = float(rng.uniform(0.10, 0.14)), float(rng.uniform(0.065, 0.09)), 0.006
    share = np.array([0.12, 0.3, 0.55, 0.8, 1.0])
    radii = rim * (0.42 + 0.58 * np.sqrt(1 - (1 - share) ** 2))
    outside = [(float(r), float(z)) for r, z in zip(radii, share * height, strict=True)]
    inside = [(r - skin, max(z, skin + 0.012)) for r, z in reversed(outside)]
    foot = [(0.0, 0.0), (0.42 * rim, 0.0)]
    return Model(kind="bowl", parts=(lathe([*foot, *outside, *inside, (0.0, 0.014)], glaze(rng), segments=40),))


def book_stack(rng: np.random.Generator) -> Model:
    """Return a few books lying on one another, slightly turned."""
    parts: list[Part] = []
    z = 0.0
    for _ in range(int(rng.integers(3, 6))):
        size = (float(rng.uniform(0.14, 0.17)), float(rng.uniform(0.20, 0.25)), float(rng.uniform(0.018, 0.04)))
        turn = float(rng.uniform(-0.25, 0.25))
        rotation = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
        parts.append(rounded_box(size, glaze(rng), at=(0.0, 0.0, z + size[2] / 2), radius_m=0.003, rotation=rotation))
        z += size[2]
    return Model(kind="books", parts=tuple(parts))


def book_row(rng: np.random.Generator) -> Model:
    """Return books standing side by side along y, their spines towards +x, as one object."""
    parts: list[Part] = []
    count, y = int(rng.integers(9, 13)), 0.0
    for _ in range(count):
        size = (float(rng.uniform(0.15, 0.18)), float(rng.uniform(0.022, 0.04)), float(rng.uniform(0.18, 0.235)))
        at = (size[0] / 2 - 0.09, y + size[1] / 2, size[2] / 2)
        parts.append(rounded_box(size, glaze(rng), at=at, radius_m=0.003))
        y += size[1]
    return Model(kind="books", parts=tuple(part.moved((0.0, -y / 2, 0.0)) for part in parts))
