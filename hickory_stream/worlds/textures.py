"""Solid textures: a colour for every point of an object's frame, so that no part needs texture coordinates.

The kernels read a table with one row per texture, since a frame has a million points of a hundred textures.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel

Pattern = Literal["plain", "wood", "checker", "stripes", "speckle", "planks", "print", "tiles", "marble"]
Color = tuple[float, float, float]

_PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
_PLAIN, _WOOD, _CHECKER, _STRIPES, _SPECKLE, _PLANKS, _PRINT, _TILES = range(8)


@dataclass(frozen=True, kw_only=True, slots=True)
class Texture:
    """A pattern of two colours (RGB in 0..1).

    `period_m` is the size of its repeating cell, `axis` (0, 1, 2 = x, y, z) the direction of the grain or the normal of
    the stripes, `grain` in 0..1 the strength of the fine noise that every pattern carries, `gloss` in 0..1 that of the
    highlights.
    """

    pattern: Pattern
    first: Color
    second: Color
    period_m: float = 0.05
    axis: int = 2
    grain: float = 0.12
    gloss: float = 0.0


def texture_table(textures: Sequence[Texture]) -> NDArray[np.float64]:
    """Return (T, 11) rows for the kernels: pattern, first RGB, second RGB, period, axis, grain, gloss."""
    rows = [(_PATTERNS.index(t.pattern), *t.first, *t.second, t.period_m, t.axis, t.grain, t.gloss) for t in textures]
    return np.array(rows, dtype=np.float64).reshape(-1, 11)


def colors_at(texture: Texture, points_object: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return the (N, 3) colours of a texture at (N, 3) points, unlit."""
    row = texture_table([texture])[0]
    albedo = _colors_at(np.ascontiguousarray(points_object, dtype=np.float64), row)
    return (albedo * 255 + 0.5).astype(np.uint8)


@kernel
def _colors_at(points, row):
    colors = np.empty((len(points), 3))
    for i in range(len(points)):
        colors[i] = albedo(points[i, 0], points[i, 1], points[i, 2], row)
    return colors


@kernel
def albedo(x, y, z, row):
    """Return the colour (r, g, b) in 0..1 of a table row at a point of the object's frame."""
    pattern, period, axis = int(row[0]), row[7], int(row[8])
    along, a, b = (x, y, z) if axis == 0 else ((y, z, x) if axis == 1 else (z, x, y))
    share = 0.0
    if pattern == _PLAIN:
        share = value_noise(x / period, y / period, z / period)
    elif pattern == _WOOD:
        warp = value_noise(along * 3.0, a * 9.0, b * 9.0)
        ring = math.sqrt((a + 0.31) ** 2 + (b + 0.17) ** 2) / period + 1.6 * warp
        share = 0.5 + 0.5 * math.sin(2 * math.pi * ring)
    elif pattern == _CHECKER:
        # Half a millimetre off the lattice, so that a face at a multiple of the period does not alternate between
        # cells.
        cells = math.floor(x / period + 0.013) + math.floor(y / period + 0.013) + math.floor(z / period + 0.013)
        share = 1.0 if int(cells) % 2 != 0 else 0.0
    elif pattern == _STRIPES:
        share = 1.0 if along / period - math.floor(along / period) < 0.5 else 0.0
    elif pattern == _SPECKLE:
        share = 1.0 if value_noise(x / period, y / period, z / period) > 0.62 else 0.0
    elif pattern == _PLANKS:
        share = _planks(along, a, b, period)
    elif pattern == _PRINT:
        share = _print(x, y, z, period)
    elif pattern == _TILES:
        share = _tiles(x, y, z, period)
    else:
        warp = value_noise(x * 6.0, y * 6.0, z * 6.0) + 0.5 * value_noise(x * 17.0, y * 17.0, z * 17.0)
        share = (0.5 + 0.5 * math.sin(2 * math.pi * ((along + 0.3 * a) / period + 2.5 * warp))) ** 3
    fine = 1.0 + row[9] * (value_noise(x * 90.0, y * 90.0, z * 90.0) + value_noise(x * 23.0, y * 23.0, z * 23.0) - 1.0)
    red = (row[1] + (row[4] - row[1]) * share) * fine
    green = (row[2] + (row[5] - row[2]) * share) * fine
    blue = (row[3] + (row[6] - row[3]) * share) * fine
    return min(max(red, 0.0), 1.0), min(max(green, 0.0), 1.0), min(max(blue, 0.0), 1.0)


@kernel
def _planks(along, a, b, period):
    """Return the share of the second colour of boards along an axis: a tone per board, grain, dark joints."""
    board = math.floor(a / period)
    length = 8.0 * period
    piece = math.floor(along / length + 0.37 * board)
    across, on = a / period - board, along / length + 0.37 * board - piece
    if across < 0.03 or on < 0.004:
        return 1.0
    tone = _lattice(int(board), int(piece), 7)
    return 0.15 + 0.35 * tone + 0.2 * value_noise(along * 4.0, a * 60.0, b * 60.0)


@kernel
def _print(x, y, z, period):
    """Return the share of ink of a print: fields that are empty, filled, pictures, or lines of text."""
    # Slanted, so that no side of a box is parallel to the cells.
    u, v = 0.86 * x + 1.1 * y + 0.013, z + 0.21 * (x - y) + 0.007
    fu, fv = math.floor(u / (1.7 * period)), math.floor(v / period)
    use = _lattice(fu, fv, 3)
    if use < 0.3:
        return 0.0
    if use < 0.42:
        return 1.0
    if use < 0.58:
        return value_noise(u * 9.0 / period, v * 9.0 / period, 0.5)
    line = period / (5.0 if use < 0.8 else 11.0)
    row = math.floor(v / line)
    if v / line - row > 0.62:
        return 0.0
    # Letters and the gaps between words.
    if _lattice(math.floor(u / (2.4 * line)), int(row), 11) < 0.2:
        return 0.0
    return 1.0 if _lattice(math.floor(u / (0.3 * line)), int(row), 5) < 0.62 else 0.0


@kernel
def _tiles(x, y, z, period):
    """Return the share of the second colour of tiles: 1 in the joints, a little in each tile."""
    px, py, pz = x / period + 0.113, y / period + 0.117, z / period + 0.119
    cx, cy, cz = math.floor(px), math.floor(py), math.floor(pz)
    for f in (px - cx, py - cy, pz - cz):
        if f < 0.04:
            return 1.0
    return 0.3 * _lattice(int(cx), int(cy), int(cz))


@kernel
def value_noise(x, y, z):
    """Return smooth noise in 0..1 with features of size 1: random values on the integer lattice, blended."""
    fx, fy, fz = math.floor(x), math.floor(y), math.floor(z)
    ix, iy, iz = int(fx), int(fy), int(fz)
    u, v, w = x - fx, y - fy, z - fz
    u, v, w = u * u * (3 - 2 * u), v * v * (3 - 2 * v), w * w * (3 - 2 * w)
    total = 0.0
    for i in range(2):
        for j in range(2):
            for k in range(2):
                weight = (u if i else 1 - u) * (v if j else 1 - v) * (w if k else 1 - w)
                total += weight * _lattice(ix + i, iy + j, iz + k)
    return total


@kernel
def _lattice(ix, iy, iz):
    """Return a pseudo-random value in 0..1 from three integers."""
    h = (ix * 374761393 + iy * 668265263 + iz * 1440662683) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 2246822519) & 0xFFFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFF) / 65535.0
