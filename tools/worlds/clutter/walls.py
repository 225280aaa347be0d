"""Walls with doors, windows, niches, skirting and pictures, in the frame of each wall: x into the room, y along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.object_models import Model, Part
from hickory_stream.worlds.rendering import GLASS
from hickory_stream.worlds.scene import at_place
from hickory_stream.worlds.support_placement import Wall
from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import chance, count, one_of, uniform
from tools.worlds.clutter.objects.solids import block

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.textures import Color
    from tools.worlds.clutter.kit import Kit


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
