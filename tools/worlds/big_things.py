"""More objects on the floor: seats, beds, storage and luggage; fronts face +x."""

import numpy as np

from hickory_stream.worlds.object_models import Model, Part, Surface, ellipsoid, lathe, rounded_box, tube
from hickory_stream.worlds.palettes import coat, fabric, glaze, plain, wood


def armchair(rng: np.random.Generator) -> Model:
    """Return an upholstered chair with arms, on short feet."""
    width, depth = float(rng.uniform(0.72, 0.84)), float(rng.uniform(0.72, 0.82))
    cloth, foot, half = fabric(rng), wood(rng, axis=2), depth / 2
    back_z, arm_z = float(rng.uniform(0.78, 0.92)), float(rng.uniform(0.54, 0.62))
    parts = [
        rounded_box((depth - 0.04, width - 0.04, 0.20), cloth, at=(0, 0, 0.20), radius_m=0.03),
        rounded_box((0.18, width, back_z - 0.1), cloth, at=(0.09 - half, 0, 0.1 + (back_z - 0.1) / 2), radius_m=0.06),
        rounded_box((depth - 0.18, width - 0.32, 0.16), cloth, at=(0.08, 0, 0.37), radius_m=0.05),
    ]
    for y in (-1, 1):
        at = (0.03, y * (width / 2 - 0.08), 0.1 + (arm_z - 0.1) / 2)
        parts.append(rounded_box((depth - 0.06, 0.16, arm_z - 0.1), cloth, at=at, radius_m=0.05))
        parts.extend(
            rounded_box((0.05, 0.05, 0.11), foot, at=(x * (half - 0.08), y * (width / 2 - 0.09), 0.055))
            for x in (-1, 1)
        )
    return Model(kind="armchair", parts=tuple(parts))


def stool(rng: np.random.Generator) -> Model:
    """Return a stool: a round seat on three or four splayed legs."""
    height, radius, timber = float(rng.uniform(0.44, 0.64)), float(rng.uniform(0.15, 0.19)), wood(rng, axis=2)
    seat = lathe([(0, height - 0.035), (radius, height - 0.035), (radius, height), (0, height)], timber)
    count = int(rng.integers(3, 5))
    legs = []
    for angle in 2 * np.pi * np.arange(count) / count + 0.4:
        out = np.array([np.cos(angle), np.sin(angle)])
        foot, top = out * radius * 1.05, out * radius * 0.62
        legs.append(tube([(*foot, 0.0), (*((foot + top) / 2), height / 2), (*top, height - 0.03)], 0.016, timber))
    return Model(kind="stool", parts=(seat, *legs))


def bench(rng: np.random.Generator) -> Model:
    """Return a low bench on two boards, its long side along y."""
    length, depth, height = float(rng.uniform(0.9, 1.25)), float(rng.uniform(0.3, 0.38)), float(rng.uniform(0.42, 0.47))
    board = wood(rng, axis=1)
    parts = [rounded_box((depth, length, 0.045), board, at=(0, 0, height - 0.0225))]
    parts += [
        rounded_box((depth - 0.06, 0.045, height - 0.04), board, at=(0, y * (length / 2 - 0.12), (height - 0.04) / 2))
        for y in (-1, 1)
    ]
    return Model(kind="bench", parts=tuple(parts))


def office_chair(rng: np.random.Generator) -> Model:
    """Return a swivel chair on a five-armed foot."""
    dark, cloth, seat_z = plain((0.13, 0.13, 0.14)), fabric(rng), float(rng.uniform(0.45, 0.52))
    parts: list[Part] = [
        tube([(0, 0, 0.07), (0, 0, 0.2), (0, 0, seat_z - 0.04)], 0.028, dark),
        rounded_box((0.46, 0.48, 0.08), cloth, at=(0.02, 0, seat_z), radius_m=0.035),
        rounded_box((0.06, 0.44, 0.5), cloth, at=(-0.22, 0, seat_z + 0.4), radius_m=0.028),
        rounded_box((0.05, 0.07, 0.3), dark, at=(-0.23, 0, seat_z + 0.1)),
    ]
    for angle in 2 * np.pi * np.arange(5) / 5:
        end = 0.28 * np.array([np.cos(angle), np.sin(angle)])
        parts.append(tube([(0, 0, 0.09), (*(end / 2), 0.08), (*end, 0.065)], 0.02, dark))
        parts.append(ellipsoid((0.03, 0.03, 0.03), dark, at=(*end, 0.03)))
    return Model(kind="office_chair", parts=tuple(parts))


def side_table(rng: np.random.Generator) -> Model:
    """Return a low round table on one column and a round foot."""
    height, radius, timber = float(rng.uniform(0.42, 0.56)), float(rng.uniform(0.24, 0.36)), wood(rng, axis=0)
    metal = coat(rng)
    parts = (
        lathe([(0, height - 0.03), (radius, height - 0.03), (radius, height), (0, height)], timber, segments=40),
        lathe([(0, 0.015), (0.03, 0.015), (0.03, height - 0.02), (0, height - 0.02)], metal, segments=16),
        lathe([(0, 0), (0.6 * radius, 0), (0.6 * radius, 0.012), (0.05, 0.03), (0, 0.03)], metal),
    )
    half = 0.6 * radius
    return Model(kind="side_table", parts=parts, surfaces=(Surface(center_m=(0, 0, height), half_m=(half, half)),))


def coffee_table(rng: np.random.Generator) -> Model:
    """Return a low table with a lower board, its long side along y."""
    length, depth, height = (
        float(rng.uniform(0.85, 1.1)),
        float(rng.uniform(0.48, 0.58)),
        float(rng.uniform(0.38, 0.45)),
    )
    board = wood(rng, axis=1)
    parts = [rounded_box((depth, length, 0.035), board, at=(0, 0, height - 0.0175), radius_m=0.01)]
    x, y = depth / 2 - 0.05, length / 2 - 0.05
    parts += [
        rounded_box((0.05, 0.05, height - 0.03), board, at=(sx * x, sy * y, (height - 0.03) / 2))
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]
    parts.append(rounded_box((depth - 0.08, length - 0.08, 0.02), board, at=(0, 0, 0.14)))
    surface = Surface(center_m=(0, 0, height), half_m=(depth / 2 - 0.03, length / 2 - 0.03))
    return Model(kind="coffee_table", parts=tuple(parts), surfaces=(surface,))


def nightstand(rng: np.random.Generator) -> Model:
    """Return a small chest with two drawers."""
    return _chest("nightstand", rng, (float(rng.uniform(0.34, 0.4)), float(rng.uniform(0.4, 0.48))), 2, 0.24)


def dresser(rng: np.random.Generator) -> Model:
    return _chest("dresser", rng, (float(rng.uniform(0.4, 0.48)), float(rng.uniform(0.8, 1.05))), 3, 0.26)


def kitchen_counter(rng: np.random.Generator) -> Model:
    """Return a low kitchen cupboard with a worktop that stands out in front."""
    width, body_z = float(rng.uniform(1.2, 1.6)), 0.86
    front, dark, top = coat(rng), plain((0.2, 0.2, 0.21)), wood(rng, axis=1)
    parts = [
        rounded_box((0.56, width, body_z - 0.09), front, at=(-0.02, 0, 0.09 + (body_z - 0.09) / 2)),
        rounded_box((0.5, width - 0.02, 0.1), dark, at=(-0.05, 0, 0.05)),
        rounded_box((0.62, width + 0.02, 0.04), top, at=(0.01, 0, body_z + 0.02)),
    ]
    doors = round(width / 0.45)
    step = width / doors
    for i in range(doors):
        y = (i - (doors - 1) / 2) * step
        parts.append(rounded_box((0.02, step - 0.012, body_z - 0.12), front, at=(0.265, y, 0.1 + (body_z - 0.1) / 2)))
        parts.append(rounded_box((0.02, 0.12, 0.014), dark, at=(0.285, y, body_z - 0.1)))
    surface = Surface(center_m=(0.02, 0, body_z + 0.04), half_m=(0.24, width / 2 - 0.08))
    return Model(kind="counter", parts=tuple(parts), surfaces=(surface,))


def _chest(kind: str, rng: np.random.Generator, size: tuple[float, float], drawers: int, drawer_m: float) -> Model:
    depth, width = size
    timber = wood(rng, axis=1) if rng.random() < 0.6 else coat(rng)
    knob, height = coat(rng), 0.06 + drawers * drawer_m
    parts = [
        rounded_box((depth, width, height - 0.05), timber, at=(0, 0, 0.05 + (height - 0.05) / 2)),
        rounded_box((depth - 0.06, width - 0.05, 0.06), knob, at=(-0.01, 0, 0.03)),
    ]
    for i in range(drawers):
        z = 0.07 + (i + 0.5) * drawer_m
        parts.append(rounded_box((0.02, width - 0.04, drawer_m - 0.02), timber, at=(depth / 2 + 0.005, 0, z)))
        parts.append(rounded_box((0.03, 0.1, 0.015), knob, at=(depth / 2 + 0.022, 0, z + 0.03)))
    surface = Surface(center_m=(0, 0, height), half_m=(depth / 2 - 0.02, width / 2 - 0.03))
    return Model(kind=kind, parts=tuple(parts), surfaces=(surface,))


def bed(rng: np.random.Generator) -> Model:
    """Return a bed with its head at -x: frame, mattress, blanket and pillows."""
    width, length = float(rng.uniform(0.95, 1.45)), float(rng.uniform(1.98, 2.08))
    timber, cover, linen = wood(rng, axis=1), fabric(rng), plain((0.92, 0.91, 0.88))
    half = length / 2
    parts = [
        rounded_box((length, width, 0.18), timber, at=(0, 0, 0.22)),
        rounded_box((0.05, width + 0.02, float(rng.uniform(0.75, 0.95))), timber, at=(-half, 0, 0.45), radius_m=0.02),
        rounded_box((length - 0.08, width - 0.04, 0.2), linen, at=(0.01, 0, 0.39), radius_m=0.05),
        rounded_box((length * 0.68, width + 0.01, 0.12), cover, at=(0.16 * length, 0, 0.455), radius_m=0.05),
    ]
    pillows = 1 if width < 1.2 else 2
    for i in range(pillows):
        y = (i - (pillows - 1) / 2) * 0.66
        parts.append(rounded_box((0.4, 0.6, 0.14), linen, at=(0.26 - half, y, 0.53), radius_m=0.065))
    parts += [
        rounded_box((0.07, 0.07, 0.16), timber, at=(x * (half - 0.08), y * (width / 2 - 0.08), 0.08))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    return Model(kind="bed", parts=tuple(parts))


def suitcase(rng: np.random.Generator) -> Model:
    depth, width, height = (
        float(rng.uniform(0.22, 0.28)),
        float(rng.uniform(0.38, 0.46)),
        float(rng.uniform(0.52, 0.66)),
    )
    shell, dark = glaze(rng), plain((0.12, 0.12, 0.13))
    parts = [rounded_box((depth, width, height), shell, at=(0, 0, 0.04 + height / 2), radius_m=0.045)]
    parts += [
        ellipsoid((0.025, 0.025, 0.025), dark, at=(x * (depth / 2 - 0.04), y * (width / 2 - 0.06), 0.025))
        for x in (-1, 1)
        for y in (-1, 1)
    ]
    top = height + 0.04
    grip = [
        (-0.05, -0.09, top - 0.02), (-0.05, -0.09, top + 0.05), (-0.05, 0.09, top + 0.05), (-0.05, 0.09, top - 0.02),
    ]  # fmt: skip
    parts.append(tube(grip, 0.011, dark))
    return Model(kind="suitcase", parts=tuple(parts))


def basket(rng: np.random.Generator) -> Model:
    """Return an open woven basket; things can lie in it."""
    rim, height = float(rng.uniform(0.19, 0.25)), float(rng.uniform(0.24, 0.32))
    foot, weave = 0.85 * rim, fabric(rng)
    profile = [(0, 0), (foot, 0), (rim, height), (rim - 0.015, height), (foot - 0.015, 0.02), (0, 0.02)]
    inner = 0.55 * foot
    surface = Surface(center_m=(0, 0, 0.02), half_m=(inner, inner), headroom_m=0.5)
    return Model(kind="basket", parts=(lathe(profile, weave, segments=40),), surfaces=(surface,))


def speaker(rng: np.random.Generator) -> Model:
    width, height, case = float(rng.uniform(0.2, 0.26)), float(rng.uniform(0.75, 1.0)), wood(rng, axis=2)
    dark = plain((0.1, 0.1, 0.11))
    parts = [
        rounded_box((0.28, width, height), case, at=(0, 0, height / 2 + 0.02)),
        rounded_box((0.32, width + 0.05, 0.03), dark, at=(0, 0, 0.015)),
        rounded_box((0.016, width - 0.03, height * 0.7), dark, at=(0.142, 0, height * 0.6)),
    ]
    return Model(kind="speaker", parts=tuple(parts))
