"""The recipes of each family: the one table that separates training, tuning and reporting."""
# The families share no recipe. `reporting` is never used to choose anything.

from dataclasses import dataclass
from typing import Literal, get_args

from hickory_stream.errors import ConfigError

Family = Literal["training", "tuning", "reporting"]
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
    "reporting": Recipes(
        small=(
            "lidded_case", "slab", "grating", "spool", "lattice_cube", "coil", "arch", "usual_bowl", "usual_carton",
            "usual_pot", "usual_pan", "usual_table_lamp", "usual_clock",
        ),
        flat=("lidded_case", "slab"),
        supports=("ladder_shelf", "trolley", "usual_bed"),
        seats=("usual_office_chair",),
        bodies=("usual_speaker", "tent"),
        units=("locker",),
        materials=("linen", "concrete", "enamel", "dotted", "plaid", "marbled", "patched"),
        contents=("pyramid", "diagonal_row"),
        groups=("island", "aisle"),
        outlines=("bay",),
    ),
}  # fmt: skip


def recipes_of(family: str) -> Recipes:
    for name in FAMILIES:
        if name == family:
            return TABLE[name]
    raise ConfigError(f"family {family!r}; expected one of {', '.join(FAMILIES)}")
