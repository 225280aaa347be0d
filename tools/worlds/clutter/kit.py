"""Random draws from the recipes of a family, and recipes of the usual objects in random proportions."""
# The recipes of each family: the one table that separates training and tuning, which share no recipe.

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from hickory_stream.errors import ConfigError
from hickory_stream.worlds import furniture, small_things
from hickory_stream.worlds.object_models import Model, Part
from hickory_stream.worlds.textures import Texture
from tools.worlds import big_things, table_things
from tools.worlds.clutter.draws import chance, one_of, uniform
from tools.worlds.clutter.objects.bodies import BODIES
from tools.worlds.clutter.objects.materials import CALM, MATERIALS, Skin
from tools.worlds.clutter.objects.small_frames import SMALL_FRAMES
from tools.worlds.clutter.objects.small_solids import SMALL_SOFT, SMALL_SOLIDS
from tools.worlds.clutter.objects.solids import stretched
from tools.worlds.clutter.objects.supports import SUPPORTS
from tools.worlds.clutter.objects.units import SEATS, UNITS

Family = Literal["training", "tuning"]
FAMILIES: tuple[Family, ...] = get_args(Family)


@dataclass(frozen=True, kw_only=True, slots=True)
class Recipes:
    """The names of a family's recipes, by kind."""

    small: tuple[str, ...]
    #: The small ones that can be stacked.
    flat: tuple[str, ...]
    #: With surfaces for other things.
    supports: tuple[str, ...]
    seats: tuple[str, ...]
    bodies: tuple[str, ...]
    #: What stands flush in rows.
    units: tuple[str, ...]
    materials: tuple[str, ...]
    #: Ways of filling a horizontal surface.
    contents: tuple[str, ...]
    #: Arrangements on the floor.
    groups: tuple[str, ...]
    outlines: tuple[str, ...]


TABLE: dict[Family, Recipes] = {
    "training": Recipes(
        small=(
            "carton", "book", "tin", "turned", "open_vessel", "blob", "superquadric", "composed", "ring", "tray",
            "crate", "pouch", "folded_cloth", "crumpled_cloth", "bent_bar", "wire_rack", "tool", "device", "framed",
            "sprig", "paper_pile", "wire_basket", "sleeve", "bent_panel",
            "usual_mug", "usual_bottle", "usual_can", "usual_cereal_box", "usual_small_box",
            "usual_monitor", "usual_squeeze_bottle", "usual_vase", "usual_ball", "usual_cushion",
        ),
        flat=("carton", "book", "paper_pile", "folded_cloth", "device"),
        supports=(
            "table", "round_table", "cabinet", "counter", "shelf", "rack", "pallet", "bed", "sofa", "usual_desk",
            "usual_shelf", "usual_dresser", "usual_coffee_table",
        ),
        seats=("chair", "usual_chair", "usual_stool"),
        bodies=(
            "big_carton", "open_carton", "barrel", "sack", "roll", "floor_lamp", "foliage", "screen", "draped",
            "blanket_heap", "rounded_body", "machine", "usual_armchair", "usual_sofa", "usual_suitcase", "usual_lamp",
        ),
        units=("appliance", "kitchen_unit"),
        materials=(
            "uniform_paint", "worn_paint", "polished", "satin", "timber", "cardboard", "printed", "striped",
            "speckled", "boarded",
        ),
        contents=("spread", "touching", "row", "same", "stacks", "heap", "cloth_and_things", "laid_rows"),
        groups=(
            "flush_row", "filled_support", "table_with_seats", "floor_heap", "floor_stacks", "floor_spread",
            "carton_wall", "solitary", "leaning", "clothes_rail", "wall_boards",
        ),
        outlines=("rectangle", "l_shape", "cut_corner", "skewed"),
    ),
    "tuning": Recipes(
        small=(
            "ribbed_pack", "binder", "goblet", "star_prism", "wedge", "usual_kettle", "usual_jar", "usual_toy_car",
            "usual_packet", "usual_laptop",
        ),
        flat=("ribbed_pack", "binder", "usual_packet"),
        supports=("trestle", "cube_shelf", "usual_table", "usual_nightstand"),
        seats=("shell_chair", "usual_bench"),
        bodies=("ladder", "usual_plant", "usual_basket"),
        units=("tower",),
        materials=("lacquered", "veneer", "brushed", "checked", "tiled"),
        contents=("ring_of_things", "leaning_row"),
        groups=("back_to_back", "corner_pile", "curtained"),
        outlines=("octagon",),
    ),
}  # fmt: skip


def recipes_of(family: str) -> Recipes:
    for name in FAMILIES:
        if name == family:
            return TABLE[name]
    raise ConfigError(f"family {family!r}; expected one of {', '.join(FAMILIES)}")


_MOST_M = 3.0
_SMALL = (
    small_things.mug, small_things.bottle, small_things.small_box, small_things.monitor,
    table_things.can, table_things.jar, table_things.cereal_box, table_things.packet,
    table_things.squeeze_bottle, table_things.kettle, table_things.vase,
    table_things.laptop, table_things.toy_car, table_things.ball, table_things.cushion,
)  # fmt: skip
_LARGE = (
    furniture.table, furniture.desk, furniture.chair, furniture.sofa, furniture.shelf, furniture.lamp,
    furniture.plant, big_things.armchair, big_things.stool, big_things.bench,
    big_things.coffee_table, big_things.nightstand, big_things.dresser, big_things.suitcase,
    big_things.basket,
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


SHAPES: dict[str, Callable[[np.random.Generator, Skin], Model]] = {
    **SMALL_SOLIDS, **SMALL_FRAMES, **SMALL_SOFT, **SUPPORTS, **SEATS, **UNITS, **BODIES, **USUAL_SMALL, **USUAL_LARGE,
}  # fmt: skip
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
        return SHAPES[name](rng, self.skin)

    def small(self, rng: np.random.Generator) -> Model:
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
