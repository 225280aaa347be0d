"""Floor plans of random rooms: outlines (K, 2) counter-clockwise, walls, floor, ceiling, columns and beams."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.clearance import is_inside
from hickory_stream.worlds.object_models import Model, Part
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import about_x, about_y, chance, count, log_uniform, one_of, uniform
from tools.worlds.clutter.footprints import rectangle
from tools.worlds.clutter.objects.solids import block, cylinder
from tools.worlds.clutter.walls import quiet, wall_frame, wall_models

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.worlds.support_placement import Wall
    from tools.worlds.clutter.kit import Kit


def outline_rectangle(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a plain room."""
    return np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size


def outline_l_shape(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room round a corner."""
    a, b = uniform(rng, 0.4, 0.7), uniform(rng, 0.4, 0.7)
    return np.array([[0, 0], [1, 0], [1, b], [a, b], [a, 1], [0, 1]]) * size


def outline_cut_corner(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room with one slanting wall."""
    a, b = uniform(rng, 0.4, 0.85), uniform(rng, 0.4, 0.85)
    return np.array([[0, 0], [1, 0], [1, b], [a, 1], [0, 1]]) * size


def outline_skewed(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return four walls of which no two are parallel."""
    shift = rng.uniform(-0.1, 0.1, size=(4, 2))
    return (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + shift) * size


def outline_octagon(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room with four cut corners."""
    c = uniform(rng, 0.15, 0.35)
    corners = [[c, 0], [1 - c, 0], [1, c], [1, 1 - c], [1 - c, 1], [c, 1], [0, 1 - c], [0, c]]
    return np.array(corners) * size


def outline_bay(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room with a bay in one wall."""
    a, b, deep = uniform(rng, 0.1, 0.3), uniform(rng, 0.6, 0.9), uniform(rng, 0.15, 0.35)
    slope = uniform(rng, 0.0, 0.08)
    corners = [[0, 0], [1, 0], [1, 1], [b, 1], [b - slope, 1 + deep], [a + slope, 1 + deep], [a, 1], [0, 1]]
    return np.array(corners) * size


OUTLINES: dict[str, Callable[[np.random.Generator, tuple[float, float]], NDArray[np.float64]]] = {
    "rectangle": outline_rectangle,
    "l_shape": outline_l_shape,
    "cut_corner": outline_cut_corner,
    "skewed": outline_skewed,
    "octagon": outline_octagon,
    "bay": outline_bay,
}
"""The outlines of rooms by name; all are counter-clockwise."""


# How far floor and ceiling extend beyond the walls, since they are visible through doors.
_BEYOND_M = 2.0
_THICK_M = 0.1


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class FloorPlan:
    """`outline_m` (K, 2) counter-clockwise; the walls along it; and other structure in the room, such as columns."""

    outline_m: NDArray[np.float64]
    height_m: float
    walls: tuple[Wall, ...]
    taken: tuple[NDArray[np.float64], ...]
    structure: tuple[Model, ...]

    @property
    def bounds_m(self) -> tuple[float, float, float, float]:
        """The rectangle (x0, y0, x1, y1) around the outline."""
        (x0, y0), (x1, y1) = self.outline_m.min(axis=0), self.outline_m.max(axis=0)
        return float(x0), float(y0), float(x1), float(y1)


def floor_plan(rng: np.random.Generator, kit: Kit) -> FloorPlan:
    """Return the plan of a room of 2 to 9 m, and its structure."""
    size = (log_uniform(rng, 2.0, 7.0), log_uniform(rng, 2.2, 9.0))
    outline = OUTLINES[one_of(rng, kit.recipes.outlines)](rng, size)
    height = uniform(rng, 2.2, 3.6)
    walls = tuple(wall_frame(a, b) for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True))
    structure = [*_slabs(rng, kit, outline, height), *wall_models(rng, kit, outline, walls, height + 1.0)]
    posts, taken = _columns(rng, kit, outline, height + 1.0)
    structure += [*posts, *_beams(rng, kit, outline, height)]
    return FloorPlan(outline_m=outline, height_m=height, walls=walls, taken=tuple(taken), structure=tuple(structure))


def _slabs(rng: np.random.Generator, kit: Kit, outline: NDArray[np.float64], height: float) -> list[Model]:
    low, high = outline.min(axis=0) - _BEYOND_M, outline.max(axis=0) + _BEYOND_M
    size, middle = high - low, (low + high) / 2
    ground = _floor(rng, kit)
    floor = block((*size, _THICK_M), ground, at=(*middle, -_THICK_M / 2), radius_m=0.001)
    rotation = np.eye(3)
    if chance(rng, 0.25):
        angle = uniform(rng, -0.5, 0.5)
        span = float(np.max(outline.max(axis=0) - outline.min(axis=0)))
        angle = float(np.clip(angle, -1.3 / span, 1.3 / span))
        rotation = about_x(angle) if chance(rng, 0.5) else about_y(angle)
    top = block((*(1.4 * size), _THICK_M), quiet(rng, kit), radius_m=0.001)
    top = top.moved((*middle, height + _THICK_M / 2), rotation)
    lamps = [
        _lamp(rng, middle + rng.uniform(-0.3, 0.3, size=2) * (size - 2 * _BEYOND_M), height, rotation)
        for _ in range(count(rng, 0, 3))
    ]
    return [Model(kind="floor", parts=(floor,)), Model(kind="ceiling", parts=(top,)), *lamps]


def _floor(rng: np.random.Generator, kit: Kit) -> Texture:
    if chance(rng, 0.6):
        return kit.skin(rng)
    return quiet(rng, kit, dim=0.3)


def _lamp(rng: np.random.Generator, at: NDArray[np.float64], height: float, rotation: NDArray[np.float64]) -> Model:
    white = Texture(pattern="plain", first=(0.97, 0.97, 0.95), second=(0.97, 0.97, 0.95), grain=0.0)
    if chance(rng, 0.5):
        part = cylinder(uniform(rng, 0.1, 0.3), 0.08, white).moved((*at, height - 0.08))
    else:
        part = block((uniform(rng, 0.2, 0.6), uniform(rng, 0.6, 1.5), 0.05), white, at=(*at, height - 0.025))
    return Model(kind="ceiling_lamp", parts=(part,)) if np.allclose(rotation, np.eye(3)) else _hung(part, white)


def _hung(part: Part, texture: Texture) -> Model:
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    middle = (low + high) / 2
    rod = block((0.02, 0.02, 2.0), texture, at=(middle[0], middle[1], high[2] + 0.4))
    return Model(kind="ceiling_lamp", parts=(part.moved((0, 0, -0.6)), rod))


def _columns(
    rng: np.random.Generator, kit: Kit, outline: NDArray[np.float64], height: float
) -> tuple[list[Model], list[NDArray[np.float64]]]:
    models, taken = [], []
    texture = quiet(rng, kit)
    for _ in range(one_of(rng, (0, 0, 0, 1, 1, 2, 3))):
        thick = log_uniform(rng, 0.06, 0.6)
        low, high = outline.min(axis=0), outline.max(axis=0)
        at = low + rng.random(2) * (high - low)
        if chance(rng, 0.4):
            corner = outline[int(rng.integers(len(outline)))]
            at = corner + (outline.mean(axis=0) - corner) * uniform(rng, 0.0, 0.12)
        if not is_inside(at[None], outline)[0]:
            continue
        if chance(rng, 0.4):
            part = cylinder(thick / 2, height, texture, segments=one_of(rng, (8, 28))).moved((*at, 0.0))
        else:
            part = block((thick, thick * uniform(rng, 0.6, 1.6), height), texture, at=(*at, height / 2), radius_m=0.002)
        models.append(Model(kind="column", parts=(part,)))
        half = np.ptp(part.vertices, axis=0) / 2
        taken.append(rectangle((float(half[0]), float(half[1])), (float(at[0]), float(at[1])), 0.0))
    return models, taken


def _beams(rng: np.random.Generator, kit: Kit, outline: NDArray[np.float64], height: float) -> list[Model]:
    if not chance(rng, 0.25):
        return []
    low, high = outline.min(axis=0), outline.max(axis=0)
    axis, texture, parts = int(rng.integers(2)), quiet(rng, kit), []
    thick, deep = uniform(rng, 0.08, 0.3), uniform(rng, 0.08, 0.35)
    for share in (np.arange(count(rng, 1, 4)) + 0.5) / 4:
        size, at = np.full(3, deep), np.array([*((low + high) / 2), height - deep / 2])
        size[axis], size[1 - axis] = high[axis] - low[axis] + 0.1, thick
        at[1 - axis] = low[1 - axis] + share * (high - low)[1 - axis]
        parts.append(block(size, texture, at=at, radius_m=0.003))
    return [Model(kind="beam", parts=tuple(parts))]
