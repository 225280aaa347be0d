"""More objects on tables and shelves: kitchenware, groceries, electronics, toys."""

import numpy as np

from hickory_stream.worlds.furniture import vessel
from hickory_stream.worlds.object_models import Model, Part, ellipsoid, lathe, rounded_box, tube
from hickory_stream.worlds.palettes import coat, fabric, glaze, plain, wood
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import about_y


def television(rng: np.random.Generator) -> Model:
    """Return a flat television on two feet, its screen towards +x."""
    width = float(rng.uniform(0.8, 1.0))
    height, dark = 0.57 * width, plain((0.08, 0.08, 0.09))
    screen = Texture(pattern="checker", first=(0.12, 0.14, 0.2), second=(0.16, 0.2, 0.28), period_m=0.2, grain=0.05)
    z = 0.06 + height / 2
    parts = [
        rounded_box((0.04, width, height), dark, at=(0, 0, z), radius_m=0.008),
        rounded_box((0.004, width - 0.03, height - 0.03), screen, at=(0.02, 0, z), radius_m=0.001),
    ]
    parts += [rounded_box((0.2, 0.03, 0.012), dark, at=(0, y * 0.35 * width, 0.006)) for y in (-1, 1)]
    parts += [rounded_box((0.03, 0.02, 0.08), dark, at=(0, y * 0.35 * width, 0.045)) for y in (-1, 1)]
    return Model(kind="television", parts=tuple(parts))


def laptop(rng: np.random.Generator) -> Model:
    """Return an open laptop, its screen towards +x."""
    width, depth = float(rng.uniform(0.31, 0.36)), float(rng.uniform(0.21, 0.25))
    shell, dark = coat(rng), plain((0.1, 0.1, 0.11))
    tilt = float(rng.uniform(0.15, 0.4))
    c, s = np.cos(tilt), np.sin(tilt)
    rotation = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    hinge = np.array([-depth / 2 + 0.005, 0, 0.014])
    lid = rounded_box((0.008, width, depth), shell, at=(0, 0, depth / 2), radius_m=0.003)
    picture = glaze(rng)
    screen = rounded_box((0.003, width - 0.02, depth - 0.02), picture, at=(0.004, 0, depth / 2), radius_m=0.001)
    parts = (
        rounded_box((depth, width, 0.018), shell, at=(0, 0, 0.009), radius_m=0.004),
        rounded_box((depth * 0.5, width - 0.04, 0.003), dark, at=(-0.03, 0, 0.018), radius_m=0.001),
        lid.moved(hinge.tolist(), rotation),
        screen.moved(hinge.tolist(), rotation),
    )
    return Model(kind="laptop", parts=parts)


def kettle(rng: np.random.Generator) -> Model:
    """Return a kettle with a spout towards +x and a handle behind."""
    radius, height = float(rng.uniform(0.075, 0.09)), float(rng.uniform(0.17, 0.21))
    metal, dark = coat(rng), plain((0.12, 0.12, 0.13))
    body = [(0, 0), (radius, 0), (0.95 * radius, 0.5 * height), (0.62 * radius, height), (0, height)]
    knob = ellipsoid((0.015, 0.015, 0.015), dark, at=(0, 0, height + 0.01))
    spout = tube(
        [(0.7 * radius, 0, 0.6 * height), (1.1 * radius, 0, 0.75 * height), (1.3 * radius, 0, 0.95 * height)],
        [0.022, 0.016, 0.013],
        metal,
    )
    handle = [
        (-0.6 * radius, 0, 0.95 * height),
        (-1.5 * radius, 0, 0.9 * height),
        (-1.55 * radius, 0, 0.4 * height),
        (-0.9 * radius, 0, 0.25 * height),
    ]
    return Model(kind="kettle", parts=(lathe(body, metal), knob, spout, tube(handle, 0.011, dark)))


def pot(rng: np.random.Generator) -> Model:
    """Return a cooking pot with a lid and two handles."""
    radius, height, metal = float(rng.uniform(0.09, 0.125)), float(rng.uniform(0.11, 0.16)), coat(rng)
    dark = plain((0.12, 0.12, 0.13))
    lid = [(0, height - 0.002), (radius + 0.004, height - 0.002), (0.5 * radius, height + 0.018), (0, height + 0.022)]
    parts = [
        lathe([(0, 0), (radius * 0.97, 0), (radius, 0.02), (radius, height), (0, height)], metal),
        lathe(lid, metal),
        ellipsoid((0.018, 0.018, 0.013), dark, at=(0, 0, height + 0.03)),
    ]
    for y in (-1, 1):
        ends = [(-0.035, y * (radius - 0.005), height * 0.75), (-0.03, y * (radius + 0.03), height * 0.75)]
        ends += [(0.03, y * (radius + 0.03), height * 0.75), (0.035, y * (radius - 0.005), height * 0.75)]
        parts.append(tube(ends, 0.007, dark))
    return Model(kind="pot", parts=tuple(parts))


def pan(rng: np.random.Generator) -> Model:
    """Return a frying pan, its handle towards +x."""
    radius, dark = float(rng.uniform(0.11, 0.14)), plain((0.14, 0.14, 0.15))
    handle = [(radius - 0.01, 0, 0.035), (radius + 0.09, 0, 0.055), (radius + 0.18, 0, 0.065)]
    return Model(kind="pan", parts=(vessel(0.78 * radius, radius, 0.045, 0.005, dark), tube(handle, 0.011, coat(rng))))


def plate_stack(rng: np.random.Generator) -> Model:
    radius, count, china = float(rng.uniform(0.1, 0.13)), int(rng.integers(3, 7)), glaze(rng)
    thick = 0.009
    profile = [(0.0, 0.0), (0.6 * radius, 0.0)]
    for i in range(count):
        profile += [(radius, i * thick + 0.011), (radius, i * thick + 0.016)]
        if i < count - 1:
            profile.append((0.9 * radius, i * thick + 0.0165))
    profile += [(0.6 * radius, count * thick + 0.003), (0.0, count * thick + 0.003)]
    return Model(kind="plates", parts=(lathe(profile, china, segments=40),))


def vase(rng: np.random.Generator) -> Model:
    belly, height, clay = float(rng.uniform(0.07, 0.1)), float(rng.uniform(0.22, 0.32)), glaze(rng)
    outside = [(0.6 * belly, 0.0), (belly, 0.35 * height), (0.75 * belly, 0.65 * height), (0.38 * belly, 0.85 * height)]
    rim = [(0.5 * belly, height), (0.5 * belly - 0.006, height), (0.38 * belly - 0.006, 0.85 * height)]
    inside = [(0.75 * belly - 0.008, 0.65 * height), (belly - 0.008, 0.35 * height), (0.6 * belly - 0.01, 0.012)]
    return Model(kind="vase", parts=(lathe([(0, 0), *outside, *rim, *inside, (0, 0.012)], clay),))


def can(rng: np.random.Generator) -> Model:
    radius, height = float(rng.uniform(0.033, 0.043)), float(rng.uniform(0.08, 0.12))
    metal = plain((0.75, 0.75, 0.76))
    parts = (
        lathe([(0, 0), (radius, 0), (radius, height), (0, height)], metal),
        lathe([(0, 0.008), (radius + 0.001, 0.008), (radius + 0.001, height - 0.008), (0, height - 0.008)], glaze(rng)),
    )
    return Model(kind="can", parts=parts)


def jar(rng: np.random.Generator) -> Model:
    radius, height = float(rng.uniform(0.036, 0.05)), float(rng.uniform(0.1, 0.15))
    body = [(0, 0), (radius, 0), (radius, 0.75 * height), (0.8 * radius, 0.86 * height), (0, 0.86 * height)]
    lid = [(0, 0.86 * height), (0.86 * radius, 0.86 * height), (0.86 * radius, height), (0, height)]
    return Model(kind="jar", parts=(lathe(body, glaze(rng)), lathe(lid, coat(rng))))


def carton(rng: np.random.Generator) -> Model:
    """Return a carton of milk or juice with a gabled top."""
    width, height, paper = float(rng.uniform(0.065, 0.08)), float(rng.uniform(0.17, 0.2)), glaze(rng)
    gable = rounded_box((0.012, width * 0.98, 0.045), paper, at=(0, 0, height + 0.02), radius_m=0.003)
    roof = [
        rounded_box((width * 0.62, width * 0.98, 0.012), paper, radius_m=0.003).moved(
            (side * width * 0.22, 0, height + 0.014), about_y(side * 0.55)
        )
        for side in (-1, 1)
    ]
    body = rounded_box((width, width, height), paper, at=(0, 0, height / 2), radius_m=0.004)
    return Model(kind="carton", parts=(body, gable, *roof))


def cereal_box(rng: np.random.Generator) -> Model:
    size = (float(rng.uniform(0.055, 0.075)), float(rng.uniform(0.17, 0.21)), float(rng.uniform(0.25, 0.31)))
    print_, panel = glaze(rng), glaze(rng)
    parts = (
        rounded_box(size, print_, at=(0, 0, size[2] / 2), radius_m=0.003),
        rounded_box((0.002, 0.7 * size[1], 0.5 * size[2]), panel, at=(size[0] / 2, 0, 0.55 * size[2]), radius_m=0.0008),
    )
    return Model(kind="cereal_box", parts=parts)


def packet(rng: np.random.Generator) -> Model:
    """Return a small packet lying flat, such as tea or pudding."""
    size = (float(rng.uniform(0.07, 0.1)), float(rng.uniform(0.1, 0.16)), float(rng.uniform(0.035, 0.055)))
    return Model(kind="packet", parts=(rounded_box(size, glaze(rng), at=(0, 0, size[2] / 2), radius_m=0.003),))


def squeeze_bottle(rng: np.random.Generator) -> Model:
    """Return a flat bottle of sauce or shampoo with a cap."""
    height, stuff = float(rng.uniform(0.15, 0.2)), glaze(rng)
    wide, flat = float(rng.uniform(0.032, 0.04)), float(rng.uniform(0.55, 0.75))
    body = lathe(
        [
            (0, 0), (wide * 0.9, 0), (wide, 0.3 * height), (0.85 * wide, 0.65 * height), (0.4 * wide, 0.8 * height),
            (0, 0.8 * height),
        ],
        stuff,
    )  # fmt: skip
    squeezed = type(body)(vertices=body.vertices * (flat, 1.0, 1.0), faces=body.faces, texture=stuff)
    cap = lathe([(0, 0.79 * height), (0.013, 0.79 * height), (0.009, height), (0, height)], plain((0.92, 0.9, 0.86)))
    return Model(kind="squeeze_bottle", parts=(squeezed, cap))


def ball(rng: np.random.Generator) -> Model:
    radius = float(rng.uniform(0.05, 0.11))
    polar = np.linspace(-np.pi / 2, np.pi / 2, 17)
    skin = lathe([(radius * float(np.cos(a)), radius * float(np.sin(a))) for a in polar], glaze(rng), segments=32)
    return Model(kind="ball", parts=(skin.moved((0, 0, radius)),))


def toy_car(rng: np.random.Generator) -> Model:
    length, paint = float(rng.uniform(0.16, 0.24)), glaze(rng, "plain")
    width, dark = 0.48 * length, plain((0.1, 0.1, 0.1))
    parts = [
        rounded_box((length, width, 0.2 * length), paint, at=(0, 0, 0.22 * length), radius_m=0.01),
        rounded_box(
            (0.5 * length, 0.85 * width, 0.18 * length), paint, at=(-0.05 * length, 0, 0.4 * length), radius_m=0.012
        ),
    ]
    wheel, across = 0.11 * length, np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    tyre = lathe([(0, -0.012), (wheel, -0.012), (wheel, 0.012), (0, 0.012)], dark, segments=20)
    parts += [tyre.moved((x * 0.3 * length, y * width / 2, wheel), across) for x in (-1, 1) for y in (-1, 1)]
    return Model(kind="toy_car", parts=tuple(parts))


def cushion(rng: np.random.Generator) -> Model:
    size = float(rng.uniform(0.36, 0.44))
    return Model(kind="cushion", parts=(rounded_box((size, size, 0.13), fabric(rng), at=(0, 0, 0.065), radius_m=0.06),))


def table_lamp(rng: np.random.Generator) -> Model:
    """Return a lamp with a bellied foot and a shade closed at its top."""
    height, shade = float(rng.uniform(0.36, 0.46)), fabric(rng)
    radius, low = float(rng.uniform(0.11, 0.14)), height - 0.17
    foot = lathe([(0, 0), (0.07, 0), (0.075, 0.02), (0.045, 0.06), (0.06, 0.12), (0.02, 0.19), (0, 0.19)], glaze(rng))
    pole = tube([(0, 0, 0.17), (0, 0, height / 2 + 0.05), (0, 0, height - 0.004)], 0.008, coat(rng))
    bell = [(0, height - 0.006), (0.6 * radius - 0.006, height - 0.006), (radius - 0.006, low), (radius, low)]
    bell += [(0.6 * radius, height), (0, height)]
    return Model(kind="table_lamp", parts=(foot, pole, lathe(bell, shade)))


def clock(rng: np.random.Generator) -> Model:
    """Return a table clock, its face towards +x."""
    size, case = float(rng.uniform(0.13, 0.19)), wood(rng, axis=1)
    face = lathe([(0, -0.004), (0.38 * size, -0.004), (0.38 * size, 0.004), (0, 0.004)], plain((0.94, 0.93, 0.88)))
    parts: tuple[Part, ...] = (
        rounded_box((0.07, size, size), case, at=(0, 0, size / 2), radius_m=0.012),
        face.moved((0.036, 0, size / 2), about_y(np.pi / 2)),
        rounded_box((0.008, 0.008, 0.3 * size), plain((0.1, 0.1, 0.1)), at=(0.041, 0, 0.62 * size), radius_m=0.002),
    )
    return Model(kind="clock", parts=parts)
