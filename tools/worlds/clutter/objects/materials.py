"""Materials."""

import colorsys
from collections.abc import Callable

import numpy as np

from hickory_stream.worlds.textures import Color, Pattern, Texture
from tools.worlds.clutter.draws import chance, log_uniform, uniform

Skin = Callable[[np.random.Generator], Texture]
"""Draws one material."""


def color(rng: np.random.Generator) -> Color:
    """Return a colour: greys and whites often, as indoors, else any hue from pale to strong."""
    kind = rng.random()
    if kind < 0.22:
        return _tinted(rng, uniform(rng, 0.55, 0.95))
    if kind < 0.36:
        return _tinted(rng, uniform(rng, 0.05, 0.3))
    if kind < 0.5:
        return _hue(rng, (0.05, 0.12), (0.25, 0.6), (0.3, 0.85))
    return _hue(rng, (0.0, 1.0), (0.15, 0.9), (0.25, 0.95))


def _tinted(rng: np.random.Generator, grey: float) -> Color:
    r, g, b = (float(np.clip(grey + rng.normal(0, 0.015), 0.02, 0.97)) for _ in range(3))
    return r, g, b


def _shade_of(rng: np.random.Generator, base: Color, spread: float) -> Color:
    factor = 1.0 - uniform(rng, 0.3 * spread, spread)
    return base[0] * factor, base[1] * factor, base[2] * factor


def _hue(
    rng: np.random.Generator, hue: tuple[float, float], saturation: tuple[float, float], value: tuple[float, float]
) -> Color:
    return colorsys.hsv_to_rgb(uniform(rng, *hue), uniform(rng, *saturation), uniform(rng, *value))


def _even(
    rng: np.random.Generator, base: Color, spread: float, period_m: float, grain: float,
    gloss: tuple[float, float] | None = None,
) -> Texture:  # fmt: skip
    shine = uniform(rng, *gloss) if gloss else 0.0
    second = _shade_of(rng, base, spread) if spread else base
    return Texture(pattern="plain", first=base, second=second, period_m=period_m, grain=grain, gloss=shine)


def _shaded(
    rng: np.random.Generator, pattern: Pattern, base: Color, spread: float, period_m: tuple[float, float],
    grain: tuple[float, float] = (0.03, 0.25),
) -> Texture:  # fmt: skip
    return _texture(rng, pattern, base, _shade_of(rng, base, spread), period_m, grain)


def _texture(
    rng: np.random.Generator, pattern: Pattern, first: Color, second: Color, period_m: tuple[float, float],
    grain: tuple[float, float] = (0.03, 0.25), gloss: tuple[float, float] = (0.0, 0.0),
) -> Texture:  # fmt: skip
    return Texture(
        pattern=pattern, first=first, second=second, period_m=log_uniform(rng, *period_m), axis=int(rng.integers(3)),
        grain=uniform(rng, *grain), gloss=uniform(rng, *gloss) if chance(rng, 0.5) else 0.0,
    )  # fmt: skip


_ANY = (0.0, 1.0)
MATERIALS: dict[str, Skin] = {
    "uniform_paint": lambda rng: _even(rng, color(rng), 0.06, 0.2, 0.02),
    "worn_paint": lambda rng: _shaded(rng, "plain", color(rng), 0.4, (0.02, 0.3), (0.05, 0.3)),
    # Metal, lacquer or glazed ware.
    "polished": lambda rng: _even(rng, color(rng), 0.1, 0.1, 0.02, (0.25, 0.95)),
    # Plastic: a broad weak highlight.
    "satin": lambda rng: _even(rng, color(rng), 0.1, 0.1, 0.04, (0.05, 0.2)),
    "lacquered": lambda rng: _even(rng, _hue(rng, _ANY, (0.5, 1.0), (0.3, 0.9)), 0.0, 0.1, 0.01, (0.3, 0.8)),
    "veneer": lambda rng: _shaded(
        rng, "stripes", _hue(rng, (0.04, 0.1), (0.1, 0.5), (0.3, 0.95)), 0.18, (0.003, 0.012), (0.05, 0.15)
    ),
    # Grey metal.
    "brushed": lambda rng: _even(rng, _tinted(rng, uniform(rng, 0.3, 0.85)), 0.1, 0.01, 0.1, (0.1, 0.5)),
    "timber": lambda rng: _shaded(rng, "wood", _hue(rng, (0.05, 0.11), (0.25, 0.6), (0.3, 0.9)), 0.4, (0.015, 0.08)),
    "cardboard": lambda rng: _even(rng, _hue(rng, (0.07, 0.1), (0.3, 0.5), (0.5, 0.8)), 0.12, 0.07, 0.12),
    # Writing, fields and pictures in one ink.
    "printed": lambda rng: _texture(rng, "print", color(rng), color(rng), (0.03, 0.15), (0.02, 0.08)),
    "striped": lambda rng: _texture(rng, "stripes", color(rng), color(rng), (0.008, 0.15)),
    # From terrazzo to flowers.
    "speckled": lambda rng: _texture(rng, "speckle", color(rng), color(rng), (0.006, 0.06)),
    "checked": lambda rng: _texture(rng, "checker", color(rng), color(rng), (0.01, 0.1)),
    "boarded": lambda rng: _shaded(rng, "planks", color(rng), 0.5, (0.03, 0.15)),
    "tiled": lambda rng: _texture(rng, "tiles", color(rng), color(rng), (0.02, 0.2), gloss=(0.0, 0.3)),
}
"""The materials by name, each of which draws its colours from the seed."""
CALM = frozenset("uniform_paint worn_paint polished satin timber cardboard lacquered veneer brushed".split())
"""The materials without a strong pattern, of which most things and nearly all large ones are made."""
