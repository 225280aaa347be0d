"""Paint for what belongs to a building."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hickory_stream.worlds.textures import Texture
from tools.worlds.clutter.draws import chance, uniform

if TYPE_CHECKING:
    import numpy as np

    from hickory_stream.worlds.textures import Color
    from tools.worlds.clutter.kit import Kit


def quiet(rng: np.random.Generator, kit: Kit, *, dim: float = 0.0) -> Texture:
    """Return a paint as walls and ceilings have: pale and even, at times any material of the family."""
    if chance(rng, 0.15):
        return kit.skin(rng)
    grey = uniform(rng, 0.6 - dim, 0.95 - dim)
    tone: Color = (grey, grey * uniform(rng, 0.92, 1.02), grey * uniform(rng, 0.8, 1.02))
    darker: Color = (tone[0] * 0.94, tone[1] * 0.94, tone[2] * 0.94)
    return Texture(pattern="plain", first=tone, second=darker, period_m=0.4, grain=uniform(rng, 0.01, 0.1))
