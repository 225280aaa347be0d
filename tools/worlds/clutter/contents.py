"""Ways of filling a horizontal surface with things: one function per recipe."""
# Poses are in the frame of the surface: its origin is the centre, x points across it (depth), y along it.

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import from_rotation_translation
from hickory_stream.worlds.scene import at_place
from hickory_stream.worlds.support_placement import REST_M
from tools.worlds.clutter.draws import about_x, about_y, chance, count, one_of, uniform
from tools.worlds.clutter.footprints import Taken, corners_of
from tools.worlds.clutter.heaps import heap as heaped
from tools.worlds.clutter.kit import SHAPES, Kit, fitted
from tools.worlds.clutter.objects.cloths import crumpled
from tools.worlds.clutter.objects.solids import grounded

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from hickory_stream.worlds.object_models import Model
    from hickory_stream.worlds.textures import Texture

    Things = list[tuple[Model, NDArray[np.float64]]]
    Filling = Callable[[np.random.Generator, Kit, "Place"], Things]


@dataclass(frozen=True, kw_only=True, slots=True)
class Place:
    """A horizontal rectangle: its half size and the free height above it."""

    half_m: tuple[float, float]
    headroom_m: float

    @property
    def most_m(self) -> tuple[float, float, float]:
        """The size of the largest thing that fits."""
        return 2 * self.half_m[0], 2 * self.half_m[1], self.headroom_m


def spread(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    area = 4 * place.half_m[0] * place.half_m[1]
    models = [kit.small(rng) for _ in range(min(14, count(rng, 1, 3 + int(10 * area))))]
    return _scattered(rng, place, models, gap_m=uniform(rng, 0.005, 0.05))


def _scattered(rng: np.random.Generator, place: Place, models: Sequence[Model], gap_m: float) -> Things:
    taken, things = Taken(), []
    straight = chance(rng, 0.3)
    for drawn in models:
        model = fitted(drawn, place.most_m)
        if model is None:
            continue
        for _ in range(12):
            yaw = float(rng.normal(0, 0.05)) if straight else uniform(rng, -np.pi, np.pi)
            pose = _standing(rng.uniform(-1, 1, size=2) * place.half_m, REST_M, yaw)
            if _is_on(model, pose, place) and taken.take(corners_of(model, pose, gap_m / 2)):
                things.append((model, pose))
                break
    return things


def _standing(at: NDArray[np.float64], z: float, yaw_rad: float) -> NDArray[np.float64]:
    return at_place(float(at[0]), float(at[1]), z, yaw_rad)


def _is_on(model: Model, pose: NDArray[np.float64], place: Place) -> bool:
    return bool((np.abs(corners_of(model, pose)) <= place.half_m).all())


def touching(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    number = count(rng, 2, 8)
    models = kit.alike(rng, number) if chance(rng, 0.3) else [kit.small(rng) for _ in range(number)]
    yaw, taken = uniform(rng, -0.3, 0.3), Taken()
    things: Things = []
    for drawn in models:
        model = fitted(drawn, (1.2 * place.half_m[0], 0.9 * place.half_m[1], place.headroom_m))
        if model is None:
            continue
        low, high = model.bounds_m()
        for _ in range(10):
            if not things:
                at = rng.uniform(-0.4, 0.4, size=2) * place.half_m
            else:
                at = _beside(rng, one_of(rng, things), low, high)
            pose = _standing(at, REST_M, yaw)
            if _is_on(model, pose, place) and taken.take(corners_of(model, pose, -0.0002)):
                things.append((model, pose))
                break
    return things


def _beside(
    rng: np.random.Generator,
    other: tuple[Model, NDArray[np.float64]],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> NDArray[np.float64]:
    (a_low, a_high), pose = other[0].bounds_m(), other[1]
    axis, sign = int(rng.integers(2)), one_of(rng, (-1, 1))
    offset = np.zeros(2)
    offset[axis] = a_high[axis] - low[axis] + 0.0005 if sign > 0 else a_low[axis] - high[axis] - 0.0005
    offset[1 - axis] = uniform(rng, -0.3, 0.3) * (a_high[1 - axis] - a_low[1 - axis])
    return np.asarray(pose[:2, :2] @ offset + pose[:2, 3])


def row(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    """Return things flush in a row, their fronts in line: books, cartons, files, jars; some rows have gaps."""
    tall = min(place.headroom_m, uniform(rng, 0.1, 0.5))
    name = one_of(rng, kit.recipes.flat if chance(rng, 0.5) else kit.recipes.small)
    mixed, gap = chance(rng, 0.3), one_of(rng, (0.0, 0.0, 0.001, 0.004, 0.02))
    size, is_level = tall * uniform(rng, 0.6, 1.0), chance(rng, 0.4)
    shared = [kit.skin(rng) for _ in range(count(rng, 1, 3))]
    one_make = chance(rng, 0.5)
    things: Things = []
    y, end = -place.half_m[1] * uniform(rng, 0.4, 1.0), place.half_m[1] * uniform(rng, 0.3, 1.0)
    front = place.half_m[0] * uniform(rng, -0.2, 1.0)
    while y < end and len(things) < 24:
        maker = kit.small(rng) if mixed else _of_make(rng, kit, name, shared if one_make else ())
        model = fitted(maker, (min(2 * place.half_m[0], 0.4), 0.6, size if is_level else size * uniform(rng, 0.7, 1.0)))
        if model is None:
            return things
        low, high = model.bounds_m()
        if y + float(high[1] - low[1]) > place.half_m[1]:
            break
        x = max(front - float(high[0]), -place.half_m[0] - float(low[0])) + float(rng.normal(0, 0.002))
        x = float(np.clip(x, -place.half_m[0] - low[0], place.half_m[0] - high[0]))
        things.append((model, at_place(x, y - float(low[1]), REST_M, 0.0)))
        y += float(high[1] - low[1]) + gap + 0.0004
    return things


def _of_make(rng: np.random.Generator, kit: Kit, name: str, shared: Sequence[Texture]) -> Model:
    if not shared:
        return kit.make(rng, name)
    return SHAPES[name](rng, lambda own: one_of(own, shared))


def same(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    """Return many things of one kind and material in rows and columns that touch, or nearly."""
    model = fitted(kit.alike(rng, 1)[0], (place.half_m[0] * 1.2, place.half_m[1] * 0.7, place.headroom_m))
    if model is None:
        return []
    low, high = model.bounds_m()
    gap = one_of(rng, (0.0006, 0.0006, 0.003, 0.02))
    pitch = high[:2] - low[:2] + gap
    most = np.maximum((2 * np.asarray(place.half_m) / pitch).astype(int), 1)
    columns, rows = count(rng, 1, min(5, int(most[0]))), count(rng, 1, min(7, int(most[1])))
    middle = (low[:2] + high[:2]) / 2
    free = np.asarray(place.half_m) - pitch * (columns, rows) / 2
    shift = rng.uniform(-1, 1, size=2) * np.maximum(free, 0.0)
    high_up = count(rng, 1, 3) if chance(rng, 0.3) and _is_flat(model) else 1
    layers = min(high_up, max(1, int(place.headroom_m / (high[2] + 0.001))))
    things: Things = []
    for k in range(layers):
        for i in range(columns):
            for j in range(rows):
                if k == layers - 1 and chance(rng, 0.15):
                    continue
                at = (np.array([i - (columns - 1) / 2, j - (rows - 1) / 2]) * pitch) - middle + shift
                things.append(
                    (model, _standing(at, REST_M + k * (float(high[2]) + 0.0005), float(rng.normal(0, 0.004))))
                )
    return things


def _is_flat(model: Model) -> bool:
    top = float(model.bounds_m()[1, 2])
    return any(s.center_m[2] > 0.95 * top for s in model.surfaces)


def stacks(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    """Return a few stacks: things on one another, each turned and moved a little."""
    things: Things = []
    taken = Taken()
    for _ in range(count(rng, 1, 4)):
        name = one_of(rng, kit.recipes.flat)
        at, yaw = rng.uniform(-0.9, 0.9, size=2) * place.half_m, uniform(rng, -0.6, 0.6)
        z, last, alike, make = 0.0, np.inf, chance(rng, 0.4), kit.alike(rng, 1)[0]
        for level in range(count(rng, 2, 7)):
            drawn = make if alike and _is_flat(make) else _flattened(kit.make(rng, name))
            model = fitted(
                drawn, (min(2 * place.half_m[0], last), min(2 * place.half_m[1], last), place.headroom_m - z)
            )
            if model is None:
                break
            low, high = model.bounds_m()
            pose = _standing(at + rng.normal(0, 0.006, size=2), z + REST_M, yaw + float(rng.normal(0, 0.06)))
            if not _is_on(model, pose, place) or (level == 0 and not taken.take(corners_of(model, pose, 0.02))):
                break
            things.append((model, pose))
            z += float(high[2]) + REST_M
            last = float((high - low)[:2].max()) * 1.1
    return things


def _flattened(model: Model) -> Model:
    size = np.ptp(model.bounds_m(), axis=0)
    if size[2] <= size[:2].min() or model.surfaces:
        return model
    turn = about_y(np.pi / 2) if size[0] < size[1] else about_x(np.pi / 2)
    return grounded(model.kind, [part.moved((0, 0, 0), turn) for part in model.parts])


def laid_rows(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    """Return flat things that lie in rows, edge to edge or nearly, alone or in piles of one make."""
    things: Things = []
    gap, deepest = one_of(rng, (0.003, 0.006, 0.015, 0.05)), uniform(rng, 0.1, 0.35)
    x = -place.half_m[0]
    while x + 0.08 < place.half_m[0] and len(things) < 40:
        y, furthest, name = -place.half_m[1] * uniform(rng, 0.6, 1.0), x, one_of(rng, kit.recipes.flat)
        while y < place.half_m[1]:
            room = (min(deepest, place.half_m[0] - x), min(0.35, place.half_m[1] - y), place.headroom_m)
            drawn = _flattened(kit.make(rng, name))
            model = fitted(drawn, room) if min(room[:2]) > 0.08 else None
            if model is None:
                break
            low, high = model.bounds_m()
            at = np.array([x - float(low[0]), y - float(low[1])])
            for level in range(count(rng, 1, 5) if chance(rng, 0.4) else 1):
                z = REST_M + level * (float(high[2]) + REST_M)
                moved = at + rng.uniform(-0.2, 0.2, size=2) * gap
                if z + float(high[2]) < place.headroom_m:
                    things.append((model, _standing(moved, z, uniform(rng, -0.3, 0.3) * gap)))
            y, furthest = y + float(high[1] - low[1]) + gap, max(furthest, x + float(high[0] - low[0]))
            if chance(rng, 0.1):
                y += uniform(rng, 0.05, 0.3)
        x = max(furthest, x + 0.02) + gap
    return things


def heap(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    number = count(rng, 4, 14)
    models = kit.alike(rng, number) if chance(rng, 0.4) else [kit.small(rng) for _ in range(number)]
    least = min(place.half_m)
    fit = [fitted(model, (1.3 * least, 1.3 * least, 1.3 * least)) for model in models]
    room = (0.55 * place.half_m[0], min(0.55 * place.half_m[1], 0.3))
    things = heaped(rng, [model for model in fit if model is not None], room) if any(fit) else []
    return [(m, pose) for m, pose in things if _top_of(m, pose) < place.headroom_m and _lies_on(m, pose, place)]


def _top_of(model: Model, pose: NDArray[np.float64]) -> float:
    return float(max((part.vertices @ pose[2, :3] + pose[2, 3]).max() for part in model.parts))


def _lies_on(model: Model, pose: NDArray[np.float64], place: Place) -> bool:
    vertices = np.concatenate([part.vertices for part in model.parts]) @ pose[:2, :3].T + pose[:2, 3]
    return bool(
        (np.abs(vertices.mean(axis=0)) < place.half_m).all()
        and (np.abs(vertices) < np.asarray(place.half_m) + 0.04).all()
    )


def cloth_and_things(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    half = (place.half_m[0] * uniform(rng, 0.3, 0.9), min(place.half_m[1] * uniform(rng, 0.2, 0.6), 0.5))
    height = min(uniform(rng, 0.03, 0.18), 0.8 * place.headroom_m)
    cloth = grounded("cloth", [crumpled(rng, (1.6 * half[0], 1.6 * half[1]), height, kit.skin(rng))])
    y = uniform(rng, -1, 1) * (place.half_m[1] - half[1])
    pose = at_place(0.0, y, REST_M, 0.0)
    things = [(cloth, pose)] if _is_on(cloth, pose, place) else []
    taken = Taken([corners_of(cloth, pose)])
    for model, at in _scattered(rng, place, [kit.small(rng) for _ in range(count(rng, 0, 5))], 0.01):
        if taken.take(corners_of(model, at)):
            things.append((model, at))
    return things


def ring_of_things(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    """Return things of one kind and material in a circle, in which neighbours touch, or nearly."""
    number = count(rng, 4, 9)
    least = 0.45 * min(place.half_m)
    model = fitted(kit.alike(rng, 1)[0], (least, least, place.headroom_m))
    if model is None:
        return []
    low, high = model.bounds_m()
    size = float(np.linalg.norm((high - low)[:2])) * 0.5
    radius = max(size * 1.05 / np.sin(np.pi / number), 0.03)
    things = []
    for turn in 2 * np.pi * np.arange(number) / number:
        pose = at_place(radius * np.cos(turn), radius * np.sin(turn), REST_M, float(turn))
        if _is_on(model, pose, place):
            things.append((model, pose))
    return things


def leaning_row(rng: np.random.Generator, kit: Kit, place: Place) -> Things:
    """Return flat things that lean on one another, like records in a box."""
    angle, things = uniform(rng, 0.1, 0.5), []
    y = -place.half_m[1] * 0.8
    for _ in range(count(rng, 3, 9)):
        drawn = fitted(kit.small(rng), (2 * place.half_m[0], 0.08, place.headroom_m * 0.85))
        if drawn is None:
            continue
        low, high = drawn.bounds_m()
        lift = float(high[1]) * np.sin(angle)
        if y + float(high[1] - low[1]) + float(high[2]) * np.sin(angle) > place.half_m[1]:
            break
        things.append((drawn, from_rotation_translation(about_x(-angle), np.array([0.0, y - low[1], lift + REST_M]))))
        y += float(high[1] - low[1]) / np.cos(angle) + 0.001
    return things


CONTENTS: dict[str, Filling] = {
    f.__name__: f
    for f in (
        spread, touching, row, same, stacks, heap, laid_rows, cloth_and_things, ring_of_things, leaning_row,
    )
}  # fmt: skip
"""The ways of filling a place by name."""
