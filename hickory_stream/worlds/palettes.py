"""Textures to draw from: every kind of object asks for a material, the seed decides its tones."""

from typing import Literal

import numpy as np

from hickory_stream.worlds.textures import Color, Pattern, Texture

_WOODS: tuple[tuple[Color, Color], ...] = (
    ((0.72, 0.53, 0.34), (0.58, 0.39, 0.23)),
    ((0.52, 0.34, 0.20), (0.38, 0.23, 0.13)),
    ((0.85, 0.73, 0.55), (0.74, 0.60, 0.42)),
    ((0.36, 0.24, 0.17), (0.26, 0.16, 0.11)),
)
_FABRICS: tuple[tuple[Color, Color], ...] = (
    ((0.28, 0.38, 0.55), (0.36, 0.47, 0.64)),
    ((0.55, 0.28, 0.25), (0.66, 0.38, 0.33)),
    ((0.45, 0.48, 0.36), (0.56, 0.58, 0.45)),
    ((0.60, 0.55, 0.48), (0.70, 0.65, 0.58)),
    ((0.70, 0.55, 0.22), (0.80, 0.66, 0.33)),
)
_GLAZES: tuple[Color, ...] = (
    (0.85, 0.25, 0.20),
    (0.20, 0.45, 0.75),
    (0.95, 0.80, 0.30),
    (0.92, 0.90, 0.84),
    (0.25, 0.55, 0.40),
    (0.55, 0.30, 0.55),
    (0.92, 0.55, 0.25),
)
_COATS: tuple[Color, ...] = ((0.88, 0.88, 0.86), (0.16, 0.17, 0.19), (0.45, 0.50, 0.53), (0.62, 0.20, 0.18))


def wood(rng: np.random.Generator, axis: int = 0) -> Texture:
    """Return a wood whose grain runs along `axis` (0, 1, 2 = x, y, z)."""
    first, second = _WOODS[int(rng.integers(len(_WOODS)))]
    return Texture(pattern="wood", first=first, second=second, period_m=float(rng.uniform(0.03, 0.07)), axis=axis)


def fabric(rng: np.random.Generator) -> Texture:
    """Return a woven stuff: plain, striped, checked or speckled."""
    first, second = _FABRICS[int(rng.integers(len(_FABRICS)))]
    patterns: tuple[Pattern, ...] = ("plain", "stripes", "checker", "speckle")
    pattern = patterns[int(rng.integers(len(patterns)))]
    period_m = 0.02 if pattern in ("plain", "speckle") else float(rng.uniform(0.05, 0.12))
    return Texture(pattern=pattern, first=first, second=second, period_m=period_m, axis=1, grain=0.25)


def glaze(rng: np.random.Generator, decor: Literal["plain", "any"] = "any") -> Texture:
    """Return a glazed ceramic or a label: one strong colour, sometimes with bands or speckles of another."""
    i, j = rng.choice(len(_GLAZES), size=2, replace=False)
    patterns: tuple[Pattern, ...] = ("plain", "stripes", "speckle")
    pattern: Pattern = "plain" if decor == "plain" else patterns[int(rng.integers(len(patterns)))]
    second = _GLAZES[int(j)] if pattern != "plain" else _GLAZES[int(i)]
    period_m = 0.04 if pattern == "stripes" else 0.012
    return Texture(pattern=pattern, first=_GLAZES[int(i)], second=second, period_m=period_m, grain=0.06)


def coat(rng: np.random.Generator) -> Texture:
    """Return a painted metal or plastic."""
    color = _COATS[int(rng.integers(len(_COATS)))]
    return plain(color)


def plain(color: Color, grain: float = 0.08) -> Texture:
    """Return one colour with faint noise."""
    darker: Color = (color[0] * 0.9, color[1] * 0.9, color[2] * 0.9)
    return Texture(pattern="plain", first=color, second=darker, period_m=0.08, grain=grain)
