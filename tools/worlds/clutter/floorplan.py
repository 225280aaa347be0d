"""Floor plans of random rooms: outlines (K, 2) counter-clockwise, walls, floor, ceiling, columns and beams."""
# A wall's frame has x into the room and y along it; the wall itself lies at x <= 0.

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.clearance import is_inside
from hickory_stream.worlds.object_models import Model, Part
from hickory_stream.worlds.rendering import GLASS
from hickory_stream.worlds.scene import at_place
from hickory_stream.worlds.support_placement import Wall
from hickory_stream.worlds.textures import Color, Texture
from tools.worlds.clutter.draws import about_x, about_y, chance, count, log_uniform, one_of, uniform
from tools.worlds.clutter.footprints import rectangle
from tools.worlds.clutter.kit import Kit
from tools.worlds.clutter.objects.solids import block, cylinder


def quiet(rng: np.random.Generator, kit: Kit, *, dim: float = 0.0) -> Texture:
    """Return a pale and even paint of walls and ceilings, at times any material of the family."""
    if chance(rng, 0.15):
        return kit.skin(rng)
    grey = uniform(rng, 0.6 - dim, 0.95 - dim)
    tone: Color = (grey, grey * uniform(rng, 0.92, 1.02), grey * uniform(rng, 0.8, 1.02))
    darker: Color = (tone[0] * 0.94, tone[1] * 0.94, tone[2] * 0.94)
    return Texture(pattern="plain", first=tone, second=darker, period_m=0.4, grain=uniform(rng, 0.01, 0.1))


@dataclass(frozen=True, kw_only=True, slots=True)
class _Opening:
    kind: str
    low_y: float
    high_y: float
    low_z: float
    high_z: float


def wall_frame(a: NDArray[np.float64], b: NDArray[np.float64]) -> Wall:
    """Return the wall from one corner to the next one: x into the room, y from b to a."""
    along = (b - a) / np.linalg.norm(b - a)
    inward = (-along[1], along[0])
    middle = (a + b) / 2
    pose = at_place(float(middle[0]), float(middle[1]), 0.0, float(np.arctan2(inward[1], inward[0])))
    return Wall(world_from_wall=pose, half_m=float(np.linalg.norm(b - a)) / 2)


def wall_models(
    rng: np.random.Generator, kit: Kit, outline: NDArray[np.float64], walls: tuple[Wall, ...], height: float
) -> list[Model]:
    """Return the walls with their openings and what is in them, skirting, dados and pictures."""
    paint, trim = quiet(rng, kit), quiet(rng, kit)
    skirting = (uniform(rng, 0.05, 0.15), uniform(rng, 0.008, 0.02)) if chance(rng, 0.6) else None
    dado = uniform(rng, 0.8, 1.3)
    has_dado, models = chance(rng, 0.15), []
    reflex = _reflex(outline)
    for i, wall in enumerate(walls):
        own = paint if chance(rng, 0.8) else quiet(rng, kit)
        thick = uniform(rng, 0.08, 0.35)
        # A wall extends behind its neighbours, but not at a reflex corner, where it would reach into the room.
        ends = (0.0 if reflex[(i + 1) % len(walls)] else thick, 0.0 if reflex[i] else thick)
        openings = _openings(rng, wall.half_m, thick)
        parts = _pierced(wall.half_m, ends, thick, height, openings, own)
        fittings: list[tuple[str, list[Part]]] = [("wall", parts)]
        for opening in openings:
            fittings += _fitting(rng, kit, opening, thick, trim)
        if skirting is not None:
            parts += _strip(wall.half_m, openings, skirting, trim)
        if has_dado:
            parts += _strip(wall.half_m, openings, (dado, 0.012), trim)
        fittings += _pictures(rng, kit, wall.half_m, openings)
        rotation, at = wall.world_from_wall[:3, :3], wall.world_from_wall[:3, 3]
        models += [
            Model(kind=kind, parts=tuple(part.moved(at, rotation) for part in pieces))
            for kind, pieces in fittings
            if pieces
        ]
    return models


def _reflex(outline: NDArray[np.float64]) -> NDArray[np.bool_]:
    # Where the room covers more than 180 degrees around a corner.
    before, after = outline - np.roll(outline, 1, axis=0), np.roll(outline, -1, axis=0) - outline
    return np.asarray(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0] < 0)


def _openings(rng: np.random.Generator, half: float, thick: float) -> list[_Opening]:
    openings: list[_Opening] = []
    y = -half + 0.1
    while True:
        y += uniform(rng, 0.1, 2.5)
        kind = one_of(rng, ("door", "door", "window", "window", "window", "niche", "way"))
        width = {"door": (0.75, 1.1), "way": (0.8, 1.8), "window": (0.5, 2.4), "niche": (0.3, 1.6)}[kind]
        wide = uniform(rng, *width)
        if y + wide > half - 0.1:
            return openings
        if chance(rng, 0.6) and (kind != "niche" or thick > 0.2):
            low = 0.0
            high = uniform(rng, 1.95, 2.15)
            if kind == "window":
                low, high = (0.0 if chance(rng, 0.2) else uniform(rng, 0.4, 1.1)), uniform(rng, 1.6, 2.4)
            if kind == "niche":
                low = 0.0 if chance(rng, 0.4) else uniform(rng, 0.3, 1.2)
                high = low + uniform(rng, 0.4, 1.6)
            openings.append(_Opening(kind=kind, low_y=y, high_y=y + wide, low_z=low, high_z=high))
        y += wide


def _pierced(
    half: float, ends: tuple[float, float], thick: float, height: float, openings: list[_Opening], texture: Texture
) -> list[Part]:
    # Full height between the openings, and the parts below and above them.
    parts, y = [], -half - ends[0]
    for opening in openings:
        parts.append(_slice(y, opening.low_y, 0.0, height, thick, texture))
        if opening.low_z > 0:
            parts.append(_slice(opening.low_y, opening.high_y, 0.0, opening.low_z, thick, texture))
        parts.append(_slice(opening.low_y, opening.high_y, opening.high_z, height, thick, texture))
        y = opening.high_y
    parts.append(_slice(y, half + ends[1], 0.0, height, thick, texture))
    return parts


def _slice(y0: float, y1: float, z0: float, z1: float, thick: float, texture: Texture) -> Part:
    return block((thick, y1 - y0, z1 - z0), texture, at=(-thick / 2, (y0 + y1) / 2, (z0 + z1) / 2), radius_m=0.0005)


def _fitting(
    rng: np.random.Generator, kit: Kit, opening: _Opening, thick: float, trim: Texture
) -> list[tuple[str, list[Part]]]:
    y, z = (opening.low_y + opening.high_y) / 2, (opening.low_z + opening.high_z) / 2
    wide, high = opening.high_y - opening.low_y, opening.high_z - opening.low_z
    if opening.kind == "window":
        deep = thick * uniform(rng, 0.3, 0.9)
        return [
            (GLASS, [_pane(rng, (wide, high), (-deep, y, z))]),
            ("window_frame", _bars(rng, (wide, high), (-deep, y, z), trim)),
        ]
    if opening.kind == "niche":
        back = block((0.03, wide, high), trim, at=(0.02 - thick, y, z), radius_m=0.0005)
        return [("wall", [back])]
    frame = uniform(rng, 0.04, 0.1)
    jambs = [block((thick + 0.03, frame, high), trim, at=(-thick / 2, y + s * (wide - frame) / 2, z)) for s in (-1, 1)]
    jambs.append(block((thick + 0.03, wide, frame), trim, at=(-thick / 2, y, opening.high_z - frame / 2)))
    if opening.kind == "way":
        far = block((0.1, wide + 2.4, 3.0), trim, at=(-thick - uniform(rng, 0.8, 1.8), y, 1.5), radius_m=0.0005)
        return [("wall", [far]), ("door_way", jambs if chance(rng, 0.5) else [])]
    leaf, sink = kit.skin(rng) if chance(rng, 0.5) else quiet(rng, kit), uniform(rng, 0.0, 0.8) * thick
    parts = [block((0.04, wide - 2 * frame, high - frame), leaf, at=(-sink - 0.02, y, z - frame / 2))]
    handle = block((0.05, 0.12, 0.02), trim, at=(-sink + 0.02, y + 0.38 * wide * one_of(rng, (-1, 1)), 1.02))
    return [("door", [*parts, handle]), ("door_way", jambs)]


def _pane(rng: np.random.Generator, size: tuple[float, float], at: tuple[float, float, float]) -> Part:
    if chance(rng, 0.2):
        tone: Color = (0.05, 0.06, 0.09)
    else:
        bright = uniform(rng, 0.7, 1.0)
        tone = (bright * uniform(rng, 0.85, 1.0), bright * uniform(rng, 0.92, 1.0), bright)
    view = Texture(
        pattern="plain", first=tone, second=(tone[0] * 0.6, tone[1] * 0.75, tone[2] * 0.7), period_m=0.8, grain=0.02
    )
    return block((0.01, *size), view, at=at, radius_m=0.0005)


def _bars(
    rng: np.random.Generator, size: tuple[float, float], at: tuple[float, float, float], texture: Texture
) -> list[Part]:
    wide, high = size
    x, y, z = at
    bar = uniform(rng, 0.03, 0.08)
    parts = [block((0.06, bar, high), texture, at=(x, y + s * (wide - bar) / 2, z)) for s in (-1, 1)]
    parts += [block((0.06, wide, bar), texture, at=(x, y, z + s * (high - bar) / 2)) for s in (-1, 1)]
    for i in range(count(rng, 0, 2)):
        parts.append(block((0.05, bar, high), texture, at=(x, y + wide * ((i + 1) / 3 - 0.5), z)))
    return parts


def _strip(half: float, openings: list[_Opening], size: tuple[float, float], texture: Texture) -> list[Part]:
    parts, y = [], -half
    for opening in [*(o for o in openings if o.low_z < size[0]), None]:
        end = half if opening is None else opening.low_y
        if end - y > 0.02:
            at = (size[1] / 2, (y + end) / 2, size[0] / 2)
            parts.append(block((size[1], end - y, size[0]), texture, at=at, radius_m=0.002))
        y = half if opening is None else opening.high_y
    return parts


def _pictures(
    rng: np.random.Generator, kit: Kit, half: float, openings: list[_Opening]
) -> list[tuple[str, list[Part]]]:
    pieces: list[tuple[str, list[Part]]] = []
    taken = [(o.low_y, o.high_y) for o in openings]
    for _ in range(count(rng, 0, 2) if half > 0.4 else 0):
        wide, high, thick = uniform(rng, 0.2, min(1.2, half)), uniform(rng, 0.2, 0.9), uniform(rng, 0.008, 0.025)
        y = uniform(rng, -1, 1) * max(half - wide / 2 - 0.05, 0.0)
        if any(low - 0.05 < y + wide / 2 and y - wide / 2 < high_y + 0.05 for low, high_y in taken):
            continue
        taken.append((y - wide / 2, y + wide / 2))
        pieces.append(
            ("picture", [block((thick, wide, high), kit.skin(rng), at=(thick / 2, y, uniform(rng, 1.4, 1.8)))])
        )
    return pieces


def outline_rectangle(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    return np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size


def outline_l_shape(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    a, b = uniform(rng, 0.4, 0.7), uniform(rng, 0.4, 0.7)
    return np.array([[0, 0], [1, 0], [1, b], [a, b], [a, 1], [0, 1]]) * size


def outline_cut_corner(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
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


OUTLINES: dict[str, Callable[[np.random.Generator, tuple[float, float]], NDArray[np.float64]]] = {
    "rectangle": outline_rectangle, "l_shape": outline_l_shape, "cut_corner": outline_cut_corner,
    "skewed": outline_skewed, "octagon": outline_octagon,
}  # fmt: skip
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
