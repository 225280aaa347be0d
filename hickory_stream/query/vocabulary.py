"""The words of a question and their meanings.

Sizes are of things in rooms: each word does not hold at its first number of metres, and holds fully at the second.
"""

from hickory_stream.query.colors import COLOR_NAMES
from hickory_stream.query.question import (
    Condition,
    Either,
    HasColor,
    HasMeasure,
    HasShape,
    Not,
    Quantity,
    Related,
    Relation,
    Serves,
    Sized,
    Thing,
    Use,
)

_SIZES: dict[str, tuple[Quantity, float, float]] = {
    "tiny": (Quantity.SIZE, 0.18, 0.10),
    "small": (Quantity.SIZE, 0.45, 0.30),
    "large": (Quantity.SIZE, 0.7, 1.0),
    "huge": (Quantity.SIZE, 1.4, 2.0),
    "tall": (Quantity.HEIGHT, 0.8, 1.2),
    "low": (Quantity.HEIGHT, 0.6, 0.4),
    "long": (Quantity.LENGTH, 0.8, 1.2),
    "wide": (Quantity.WIDTH, 0.5, 0.8),
    "narrow": (Quantity.WIDTH, 0.45, 0.3),
    "high": (Quantity.UNDERSIDE, 0.9, 1.3),
}
_SYNONYMS = {"big": "large", "short": "low", "little": "small", "gigantic": "huge", "deep": "wide"}

ADJECTIVES: dict[str, Condition] = {
    **{name: HasColor(name=name) for name in COLOR_NAMES},
    "grey": HasColor(name="gray"),
    "violet": HasColor(name="purple"),
    **{name: HasMeasure(name=name, quantity=of[0], zero_at=of[1], one_at=of[2]) for name, of in _SIZES.items()},
    **{
        word: HasMeasure(name=name, quantity=_SIZES[name][0], zero_at=_SIZES[name][1], one_at=_SIZES[name][2])
        for word, name in _SYNONYMS.items()
    },
    "flat": HasShape(name="flat"),
    "thin": HasShape(name="thin"),
    "slender": HasShape(name="thin"),
    "hollow": HasShape(name="hollow"),
    "cylindrical": HasShape(name="cylinder"),
    "round": HasShape(name="ball"),
    "spherical": HasShape(name="ball"),
    "boxy": HasShape(name="box"),
    "rectangular": HasShape(name="box"),
}


def _at_least(name: str, quantity: Quantity, zero_at: float, one_at: float) -> HasMeasure:
    return HasMeasure(name=name, quantity=quantity, zero_at=zero_at, one_at=one_at)


def _not(*conditions: Condition) -> Not:
    return Not(thing=Thing(conditions=conditions))


def _either(name: str, *things: tuple[Condition, ...]) -> Either:
    return Either(name=name, things=tuple(Thing(conditions=conditions) for conditions in things))


def _sized(name: str, *sides_m: tuple[float, float]) -> Sized:
    return Sized(name=name, sides_m=sides_m)


_SEAT = Serves(use=Use.SIT_ON)
_TOP = Serves(use=Use.PUT_ON)
_BOX = HasShape(name="box")
_IRREGULAR = _not(_either("box, cylinder or ball", *((HasShape(name=name),) for name in ("box", "cylinder", "ball"))))
_ON_FLOOR = Related(relation=Relation.ON, to="floor")
_UPRIGHT = _at_least("upright", Quantity.SLENDERNESS, 1.3, 1.8)

# What is asked for. Pieces of furniture are what their geometry makes of them: whatever one can sit on that is as long
# as this is a sofa. These are definitions of words; nothing in the map is made by them.
NOUNS: dict[str, tuple[Condition, ...]] = {
    **dict.fromkeys(("thing", "object", "item", "something", "anything", "one", "what"), ()),
    **dict.fromkeys(("box", "cube", "block"), (HasShape(name="box"),)),
    **dict.fromkeys(("cylinder", "tube"), (HasShape(name="cylinder"),)),
    **dict.fromkeys(("ball", "sphere"), (HasShape(name="ball"),)),
    **dict.fromkeys(("container", "vessel"), (HasShape(name="hollow"),)),
    "fixture": (_at_least("fixture", Quantity.FIXED, 0.25, 0.75),),
    "seat": (_SEAT,),
    "chair": (
        _SEAT,
        _at_least("with a back", Quantity.HEIGHT, 0.55, 0.65),
        _at_least("for one", Quantity.LENGTH, 1.1, 0.9),
    ),
    "stool": (
        _SEAT,
        _at_least("without a back", Quantity.HEIGHT, 0.65, 0.55),
        _at_least("for one", Quantity.LENGTH, 0.8, 0.6),
    ),
    **dict.fromkeys(("sofa", "couch", "bench"), (_SEAT, _at_least("for two", Quantity.LENGTH, 0.9, 1.1))),
    "surface": (_TOP,),
    **dict.fromkeys(
        ("table", "desk"),
        (
            _TOP,
            _at_least("as long as a table", Quantity.LENGTH, 0.4, 0.6),
            _at_least("not flat", Quantity.HEIGHT, 0.25, 0.35),
        ),
    ),
}

# Things for which size, shape and place stand in, unless an image-text network judges their looks. The sizes (longer
# and shorter side of the footprint, height) span these: bottles of the YCB set (19 to 27 cm high; Calli et al. 2015),
# of 0.33 l, and of 2 l (10 x 42 cm); mug, bowl and plate of the YCB set (8 x 8, 16 x 5 and 26 x 2 cm), the mug with a
# handle of 4 cm, and others half as large or twice; screens of 16:9 from 22 to 90 inches (49 x 27 to 199 x 112 cm)
# with a foot; lamps for tables (25 to 86 cm high) and floors (147 to 183 cm), with shades of up to 51 cm; bookcases
# (from 61 cm wide, 26 to 50 cm deep, 76 to 210 cm high). A plant is greener than shaded wood.
_CUP = (_sized("cup", (0.06, 0.14), (0.06, 0.11), (0.06, 0.14)), _not(_BOX), _not(_ON_FLOOR))
_LAMP = _either(
    "floor lamp or table lamp",
    (_sized("floor lamp", (0.2, 0.55), (0.2, 0.55), (1.3, 1.9)), _ON_FLOOR),
    (_sized("table lamp", (0.1, 0.51), (0.1, 0.51), (0.25, 0.9)), _not(_ON_FLOOR)),
)
_SHELF = (_sized("bookcase", (0.6, 2.0), (0.22, 0.5), (0.75, 2.2)), _ON_FLOOR, _not(_SEAT))
_WIDE = _at_least("wider than high", Quantity.SLENDERNESS, 1.0, 0.85)
_SCREEN = (_sized("screen", (0.45, 2.0), (0.01, 0.26), (0.27, 1.2)), _WIDE, _not(_ON_FLOOR))
STAND_INS: dict[str, tuple[Condition, ...]] = {
    "bottle": (_sized("bottle", (0.05, 0.13), (0.05, 0.11), (0.15, 0.42)), _UPRIGHT, _not(_BOX)),
    **dict.fromkeys(("cup", "mug", "glass"), _CUP),
    "bowl": (_sized("bowl", (0.11, 0.32), (0.11, 0.32), (0.04, 0.15)), HasShape(name="hollow")),
    "plate": (_sized("plate", (0.15, 0.33), (0.15, 0.33), (0.01, 0.05)), HasShape(name="flat")),
    "lamp": (_LAMP, _UPRIGHT, _not(_BOX)),
    **dict.fromkeys(("shelf", "bookshelf", "bookcase"), _SHELF),
    **dict.fromkeys(("screen", "monitor", "television", "tv"), _SCREEN),
    "plant": (
        _sized("plant", (0.15, 1.5), (0.15, 1.5), (0.2, 2.2)),
        HasColor(name="green", share=(0.3, 0.5)),
        _IRREGULAR,
    ),
}

_PHRASES: dict[Relation, tuple[str, ...]] = {
    Relation.ON: ("on", "on top of"),
    Relation.CARRYING: ("carrying", "holding"),
    Relation.UNDER: ("under", "below", "underneath", "beneath"),
    Relation.ABOVE: ("above", "over"),
    Relation.IN_FRONT_OF: ("in front of",),
    Relation.BEHIND: ("behind",),
    Relation.LEFT_OF: ("left of", "to the left of", "on the left of"),
    Relation.RIGHT_OF: ("right of", "to the right of", "on the right of"),
    Relation.IN: ("in", "inside"),
    Relation.BESIDE: ("beside", "next to", "against"),
    Relation.NEAR: ("near", "close to", "by", "at"),
}
# The longest first: "on" begins "on top of".
RELATIONS: dict[tuple[str, ...], Relation] = {
    tuple(phrase.split()): relation
    for phrase, relation in sorted(((phrase, one) for one in _PHRASES for phrase in _PHRASES[one]), reverse=True)
}

_THINGS = ("things", "thing", "something", "it", "objects", "stuff")
USES: dict[tuple[str, ...], Use] = {
    ("to", "sit", "on"): Use.SIT_ON,
    ("to", "sit"): Use.SIT_ON,
    **{("to", verb, thing, "on"): Use.PUT_ON for verb in ("put", "place", "set") for thing in _THINGS},
    **{("to", verb, thing, "in"): Use.PUT_IN for verb in ("put", "place", "keep") for thing in _THINGS},
}

_GRADES = {
    ("larger", "largest"): (Quantity.SIZE, True),
    ("bigger", "biggest"): (Quantity.SIZE, True),
    ("smaller", "smallest"): (Quantity.SIZE, False),
    ("taller", "tallest"): (Quantity.HEIGHT, True),
    ("shorter", "shortest"): (Quantity.HEIGHT, False),
    ("longer", "longest"): (Quantity.LENGTH, True),
    ("wider", "widest"): (Quantity.WIDTH, True),
    ("narrower", "narrowest"): (Quantity.WIDTH, False),
    ("higher", "highest"): (Quantity.UNDERSIDE, True),
    ("lower", "lowest"): (Quantity.UNDERSIDE, False),
}
# Comparisons with a length, and whether more is meant; superlatives, and whether the least is.
COMPARISONS: dict[str, tuple[Quantity, bool]] = {words[0]: grade for words, grade in _GRADES.items()}
SUPERLATIVES = {words[1]: (quantity, not is_more) for words, (quantity, is_more) in _GRADES.items()}
NEAREST = ("nearest", "closest")
UNITS_M = {"m": 1.0, "metre": 1.0, "metres": 1.0, "meter": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001}
ROOM_WORDS = {"floor": "floor", "ground": "floor", "wall": "wall", "walls": "wall"}
COUNTING = (("how", "many"), ("number", "of"), ("count",))
# Words that say nothing of the object.
FILLERS = frozenset(
    "a an the any all some find show me where what which is are there that it please with and also very of".split()
)
