"""Random draws from the recipes of a family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tools.worlds.clutter.draws import chance, one_of
from tools.worlds.clutter.families import recipes_of
from tools.worlds.clutter.objects.bodies import BODIES
from tools.worlds.clutter.objects.materials import CALM, MATERIALS
from tools.worlds.clutter.objects.small_frames import SMALL_FRAMES
from tools.worlds.clutter.objects.small_solids import SMALL_SOFT, SMALL_SOLIDS
from tools.worlds.clutter.objects.solids import stretched
from tools.worlds.clutter.objects.supports import SUPPORTS
from tools.worlds.clutter.objects.units import SEATS, UNITS
from tools.worlds.clutter.objects.usual_kinds import USUAL_LARGE, USUAL_SMALL

if TYPE_CHECKING:
    from collections.abc import Callable

    from hickory_stream.worlds.object_models import Model
    from hickory_stream.worlds.textures import Texture
    from tools.worlds.clutter.families import Recipes
    from tools.worlds.clutter.objects.materials import Skin

SHAPES: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    **SMALL_SOLIDS,
    **SMALL_FRAMES,
    **SMALL_SOFT,
    **SUPPORTS,
    **SEATS,
    **UNITS,
    **BODIES,
    **USUAL_SMALL,
    **USUAL_LARGE,
}
"""All recipes of things by name."""
_LEAST_M = 0.03
_CALM_SHARE = 0.5


@dataclass(frozen=True, kw_only=True, slots=True)
class Kit:
    """Draws things and materials of one family; `tones` are the few materials that recur in one room."""

    recipes: Recipes
    tones: tuple[Texture, ...]

    def skin(self, rng: np.random.Generator) -> Texture:
        """Return a material: one of the room's recurring ones, or any of the family's."""
        if self.tones and chance(rng, 0.3):
            tone: Texture = one_of(rng, self.tones)
            return tone
        return any_material(rng, self.recipes)

    def make(self, rng: np.random.Generator, name: str) -> Model:
        """Return a thing by the recipe of a name."""
        return SHAPES[name](rng, self.skin)

    def small(self, rng: np.random.Generator) -> Model:
        """Return a small thing."""
        return self.make(rng, one_of(rng, self.recipes.small))

    def alike(self, rng: np.random.Generator, number: int) -> list[Model]:
        """Return small things of one recipe and one material, of equal or different sizes."""
        name, skin = one_of(rng, self.recipes.small), self.skin(rng)
        first = SHAPES[name](rng, lambda _: skin)
        if chance(rng, 0.5):
            return [first] * number
        return [SHAPES[name](rng, lambda _: skin) for _ in range(number)]


def any_material(rng: np.random.Generator, recipes: Recipes) -> Texture:
    """Return any material of a family, mostly one without a strong pattern."""
    calm = [name for name in recipes.materials if name in CALM]
    return MATERIALS[one_of(rng, calm if chance(rng, _CALM_SHARE) else recipes.materials)](rng)


def kit_of(rng: np.random.Generator, family: str) -> Kit:
    """Return the kit of a room; raises `ConfigError` for an unknown family."""
    recipes = recipes_of(family)
    return Kit(recipes=recipes, tones=tuple(any_material(rng, recipes) for _ in range(int(rng.integers(0, 4)))))


def fitted(model: Model, most_m: tuple[float, float, float]) -> Model | None:
    """Return a model scaled down to fit a size (x, y, z), None if it would become too small."""
    low, high = model.bounds_m()
    factor = min(1.0, float(np.min(np.asarray(most_m) / (high - low))))
    if factor == 1.0:
        return model
    small = stretched(model, (factor,) * 3)
    return small if factor > 0.35 and float((high - low).max()) * factor > _LEAST_M else None
