"""Materials: one function each, which draws its colours from the seed."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import chance, log_uniform, uniform

if TYPE_CHECKING:
    from hickory_stream.worlds.textures import Color, Pattern

Skin = Callable[[np.random.Generator], Texture]
"""Draws one material."""


def color(rng: np.random.Generator) -> Color:
    """Return a colour: greys and whites often, as indoors, else any hue from pale to strong."""
    kind = rng.random()
    if kind < 0.22:
        grey = uniform(rng, 0.55, 0.95)
        return _tinted(rng, grey)
    if kind < 0.36:
        return _tinted(rng, uniform(rng, 0.05, 0.3))
    if kind < 0.5:
        return colorsys.hsv_to_rgb(uniform(rng, 0.05, 0.12), uniform(rng, 0.25, 0.6), uniform(rng, 0.3, 0.85))
    return colorsys.hsv_to_rgb(uniform(rng, 0, 1), uniform(rng, 0.15, 0.9), uniform(rng, 0.25, 0.95))


def _tinted(rng: np.random.Generator, grey: float) -> Color:
    r, g, b = (float(np.clip(grey + rng.normal(0, 0.015), 0.02, 0.97)) for _ in range(3))
    return r, g, b


def _shade_of(rng: np.random.Generator, base: Color, spread: float) -> Color:
    factor = 1.0 - uniform(rng, 0.3 * spread, spread)
    return base[0] * factor, base[1] * factor, base[2] * factor


def uniform_paint(rng: np.random.Generator) -> Texture:
    """Return one even colour, nearly without grain."""
    base = color(rng)
    return Texture(pattern="plain", first=base, second=_shade_of(rng, base, 0.06), period_m=0.2, grain=0.02)


def worn_paint(rng: np.random.Generator) -> Texture:
    """Return a colour with stains of its own shades."""
    base = color(rng)
    return _texture(rng, "plain", base, _shade_of(rng, base, 0.4), (0.02, 0.3), grain=(0.05, 0.3))


def polished(rng: np.random.Generator) -> Texture:
    """Return metal, lacquer or glazed ware: even and shiny."""
    base = color(rng)
    gloss = uniform(rng, 0.25, 0.95)
    return Texture(pattern="plain", first=base, second=_shade_of(rng, base, 0.1), period_m=0.1, grain=0.02, gloss=gloss)


def lacquered(rng: np.random.Generator) -> Texture:
    """Return a strong colour under a hard varnish."""
    base = colorsys.hsv_to_rgb(uniform(rng, 0, 1), uniform(rng, 0.5, 1.0), uniform(rng, 0.3, 0.9))
    return Texture(pattern="plain", first=base, second=base, period_m=0.1, grain=0.01, gloss=uniform(rng, 0.3, 0.8))


def veneer(rng: np.random.Generator) -> Texture:
    """Return wood with a straight narrow grain."""
    base = colorsys.hsv_to_rgb(uniform(rng, 0.04, 0.1), uniform(rng, 0.1, 0.5), uniform(rng, 0.3, 0.95))
    return _texture(rng, "stripes", base, _shade_of(rng, base, 0.18), (0.003, 0.012), grain=(0.05, 0.15))


def brushed(rng: np.random.Generator) -> Texture:
    """Return brushed metal: grey, a broad highlight."""
    base = _tinted(rng, uniform(rng, 0.3, 0.85))
    gloss = uniform(rng, 0.1, 0.5)
    return Texture(pattern="plain", first=base, second=_shade_of(rng, base, 0.1), period_m=0.01, grain=0.1, gloss=gloss)


def linen(rng: np.random.Generator) -> Texture:
    """Return a plain weave."""
    base = color(rng)
    return _texture(rng, "plain", base, _shade_of(rng, base, 0.3), (0.003, 0.01), grain=(0.1, 0.3))


def concrete(rng: np.random.Generator) -> Texture:
    """Return cast stone: grey with clouds."""
    base = _tinted(rng, uniform(rng, 0.35, 0.8))
    return _texture(rng, "plain", base, _shade_of(rng, base, 0.25), (0.05, 0.4), grain=(0.1, 0.3))


def enamel(rng: np.random.Generator) -> Texture:
    """Return a pale glossy coat."""
    base = colorsys.hsv_to_rgb(uniform(rng, 0, 1), uniform(rng, 0.0, 0.35), uniform(rng, 0.75, 0.97))
    return Texture(pattern="plain", first=base, second=base, period_m=0.1, grain=0.01, gloss=uniform(rng, 0.3, 0.9))


def satin(rng: np.random.Generator) -> Texture:
    """Return plastic: a colour with a broad weak highlight."""
    base = color(rng)
    gloss = uniform(rng, 0.05, 0.2)
    return Texture(pattern="plain", first=base, second=_shade_of(rng, base, 0.1), period_m=0.1, grain=0.04, gloss=gloss)


def timber(rng: np.random.Generator) -> Texture:
    """Return wood with its rings."""
    base = colorsys.hsv_to_rgb(uniform(rng, 0.05, 0.11), uniform(rng, 0.25, 0.6), uniform(rng, 0.3, 0.9))
    return _texture(rng, "wood", base, _shade_of(rng, base, 0.4), (0.015, 0.08))


def cardboard(rng: np.random.Generator) -> Texture:
    """Return the brown of cartons, bare or faintly stained."""
    base = colorsys.hsv_to_rgb(uniform(rng, 0.07, 0.1), uniform(rng, 0.3, 0.5), uniform(rng, 0.5, 0.8))
    return Texture(pattern="plain", first=base, second=_shade_of(rng, base, 0.12), period_m=0.07, grain=0.12)


def printed(rng: np.random.Generator) -> Texture:
    """Return a package print: writing, fields and pictures in one ink."""
    return _texture(rng, "print", color(rng), color(rng), (0.03, 0.15), grain=(0.02, 0.08))


def striped(rng: np.random.Generator) -> Texture:
    """Return stripes, fine or broad."""
    return _texture(rng, "stripes", color(rng), color(rng), (0.008, 0.15))


def speckled(rng: np.random.Generator) -> Texture:
    """Return speckles, from terrazzo to flowers."""
    return _texture(rng, "speckle", color(rng), color(rng), (0.006, 0.06))


def checked(rng: np.random.Generator) -> Texture:
    """Return a chequered pattern."""
    return _texture(rng, "checker", color(rng), color(rng), (0.01, 0.1))


def boarded(rng: np.random.Generator) -> Texture:
    """Return narrow boards."""
    base = color(rng)
    return _texture(rng, "planks", base, _shade_of(rng, base, 0.5), (0.03, 0.15))


def dotted(rng: np.random.Generator) -> Texture:
    """Return regular dots."""
    return _texture(rng, "dots", color(rng), color(rng), (0.012, 0.08))


def tiled(rng: np.random.Generator) -> Texture:
    """Return tiles with joints."""
    return _texture(rng, "tiles", color(rng), color(rng), (0.02, 0.2), gloss=(0.0, 0.3))


def plaid(rng: np.random.Generator) -> Texture:
    """Return crossing bands, as of a blanket."""
    return _texture(rng, "plaid", color(rng), color(rng), (0.02, 0.15))


def marbled(rng: np.random.Generator) -> Texture:
    """Return veined stone."""
    base = color(rng)
    return _texture(rng, "marble", base, color(rng), (0.1, 0.4), gloss=(0.0, 0.4))


def patched(rng: np.random.Generator) -> Texture:
    """Return fields with straight borders between two colours, as of patchwork or camouflage."""
    return _texture(rng, "cells", color(rng), color(rng), (0.02, 0.15))


def _texture(
    rng: np.random.Generator,
    pattern: Pattern,
    first: Color,
    second: Color,
    period_m: tuple[float, float],
    grain: tuple[float, float] = (0.03, 0.25),
    gloss: tuple[float, float] = (0.0, 0.0),
) -> Texture:
    return Texture(
        pattern=pattern,
        first=first,
        second=second,
        period_m=log_uniform(rng, *period_m),
        axis=int(rng.integers(3)),
        grain=uniform(rng, *grain),
        gloss=uniform(rng, *gloss) if chance(rng, 0.5) else 0.0,
    )


MATERIALS: dict[str, Callable[[np.random.Generator], Texture]] = {
    f.__name__: f
    for f in (
        uniform_paint,
        worn_paint,
        polished,
        satin,
        lacquered,
        veneer,
        brushed,
        linen,
        concrete,
        enamel,
        timber,
        cardboard,
        printed,
        striped,
        speckled,
        checked,
        boarded,
        dotted,
        tiled,
        plaid,
        marbled,
        patched,
    )
}
"""The materials by name."""
CALM = frozenset(
    "uniform_paint worn_paint polished satin timber cardboard lacquered veneer brushed linen concrete enamel".split()
)
"""The materials without a strong pattern, of which most things and nearly all large ones are made."""
