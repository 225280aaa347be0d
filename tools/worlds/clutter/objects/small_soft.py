"""Small soft things, 10 to 50 cm: one function per recipe, each lying on its base."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tools.worlds.clutter.draws import count, log_uniform, uniform
from tools.worlds.clutter.objects.cloths import crumpled
from tools.worlds.clutter.objects.solids import grounded, rough, superellipsoid, warped

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from hickory_stream.worlds.object_models import Model
    from tools.worlds.clutter.objects.materials import Skin


def pouch(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a filled bag: slack, wider below, creased, its neck drawn together or folded."""
    semi = log_uniform(rng, 0.05, 0.18) * rng.uniform(0.7, 1.3, size=3)
    part = superellipsoid(semi, (uniform(rng, 0.5, 0.9), uniform(rng, 0.4, 0.9)), skin(rng), rings=21)
    pinch, sag = uniform(rng, 0.0, 0.6), uniform(rng, 0.0, 0.3)

    def slack(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
        height = vertices[:, 2:] / semi[2]
        width = 1.0 + sag * (-height) - pinch * np.maximum(height, 0.0) ** 2
        return np.asarray(vertices * (1, 1, 0) * width + vertices * (0, 0, 1) * np.where(height < 0, 0.75, 1.0))

    return grounded("bag", [rough(warped(part, slack), rng, 0.06 * float(semi.min()), float(semi.min()))])


def folded_cloth(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a folded towel or garment: a few soft layers."""
    x, y, layer = uniform(rng, 0.15, 0.4), uniform(rng, 0.15, 0.4), uniform(rng, 0.012, 0.035)
    stuff, z, parts = skin(rng), 0.0, []
    for _ in range(count(rng, 1, 5)):
        part = superellipsoid((x / 2, y / 2, layer / 2), (0.4, 0.15), stuff, rings=11, around=32)
        shift = rng.normal(0, 0.006, size=2)
        parts.append(rough(part, rng, 0.005, 0.15).moved((*shift, z)))
        z += layer * 0.9
    return grounded("folded_cloth", parts)


def crumpled_cloth(rng: np.random.Generator, skin: Skin) -> Model:
    """Return a cloth that lies crumpled: a wavy sheet, higher in the middle."""
    size, height = uniform(rng, 0.15, 0.5), uniform(rng, 0.03, 0.15)
    return grounded("crumpled_cloth", [crumpled(rng, (size, size * uniform(rng, 0.6, 1.0)), height, skin(rng))])


SMALL_SOFT: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    f.__name__: f
    for f in (
        pouch,
        folded_cloth,
        crumpled_cloth,
    )
}
"""The recipes of soft small things by name."""
