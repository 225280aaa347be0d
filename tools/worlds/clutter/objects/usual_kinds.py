"""The objects of the furnished rooms in random proportions, with their own materials or some of the family's."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import Part
from tools.worlds import big_things, table_things
from tools.worlds.clutter.draws import chance, uniform
from tools.worlds.clutter.objects.solids import stretched

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.worlds.object_models import Model
    from tools.worlds.clutter.objects.materials import Skin

_MOST_M = 3.0
_SMALL = (
    small_things.mug, small_things.bottle, small_things.bowl, small_things.small_box, small_things.monitor,
    table_things.can, table_things.jar, table_things.carton, table_things.cereal_box, table_things.packet,
    table_things.squeeze_bottle, table_things.kettle, table_things.pot, table_things.pan, table_things.vase,
    table_things.laptop, table_things.toy_car, table_things.ball, table_things.cushion, table_things.table_lamp,
    table_things.clock,
)  # fmt: skip
_LARGE = (
    furniture.table, furniture.desk, furniture.chair, furniture.sofa, furniture.shelf, furniture.lamp,
    furniture.plant, big_things.armchair, big_things.stool, big_things.bench, big_things.office_chair,
    big_things.coffee_table, big_things.nightstand, big_things.dresser, big_things.bed, big_things.suitcase,
    big_things.basket, big_things.speaker,
)  # fmt: skip


def _varied(
    maker: Callable[[np.random.Generator], Model], spread: float
) -> Callable[[np.random.Generator, Skin], Model]:
    def recipe(rng: np.random.Generator, skin: Skin) -> Model:
        model = maker(rng)
        whole = uniform(rng, 1.0 - 0.6 * spread, 1.0 + 0.6 * spread)
        model = stretched(model, [whole * uniform(rng, 1.0 - spread, 1.0 + spread) for _ in range(3)])
        longest = float(np.ptp(model.bounds_m(), axis=0).max())
        model = _on_its_base(stretched(model, (min(1.0, _MOST_M / longest),) * 3))
        if chance(rng, 0.5):
            # Each material of the model is replaced by one other, so that parts of equal material stay equal.
            other = {id(part.texture): skin(rng) for part in model.parts}
            parts = (Part(vertices=p.vertices, faces=p.faces, texture=other[id(p.texture)]) for p in model.parts)
            model = replace(model, parts=tuple(parts))
        return model

    return recipe


def _on_its_base(model: Model) -> Model:
    # Splayed legs reach slightly below their base.
    low = float(model.bounds_m()[0, 2])
    parts = tuple(part.moved((0.0, 0.0, -low)) for part in model.parts)
    surfaces = tuple(replace(s, center_m=(*s.center_m[:2], s.center_m[2] - low)) for s in model.surfaces)
    return replace(model, parts=parts, surfaces=surfaces)


USUAL_SMALL = {f"usual_{maker.__name__}": _varied(maker, 0.35) for maker in _SMALL}
"""Recipes of the kinds that stand on furniture, by name."""
USUAL_LARGE = {f"usual_{maker.__name__}": _varied(maker, 0.25) for maker in _LARGE}
"""Recipes of the kinds that stand on the floor, by name."""
