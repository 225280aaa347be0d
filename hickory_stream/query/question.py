"""A question from the grammar: conditions that each object fulfils to a degree."""

from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from typing import Literal


class Relation(StrEnum):
    """Relation of an object to another one, or to a place; `CARRYING` is the inverse of `ON`."""

    ON = "on"
    CARRYING = "carrying"
    UNDER = "under"
    ABOVE = "above"
    IN = "in"
    BESIDE = "beside"
    NEAR = "near"
    IN_FRONT_OF = "in front of"
    BEHIND = "behind"
    LEFT_OF = "left of"
    RIGHT_OF = "right of"


class Quantity(StrEnum):
    """A comparable quantity in metres; `UNDERSIDE` is the height of an object's lowest point.

    `SLENDERNESS` is a ratio: the height over the longer horizontal side; `FIXED` is a probability.
    """

    SIZE = "longest side"
    LENGTH = "longer horizontal side"
    WIDTH = "shorter horizontal side"
    HEIGHT = "height"
    UNDERSIDE = "height above the floor"
    SLENDERNESS = "height over width"
    FIXED = "probability of a fixture"


class Use(StrEnum):
    """A use of an object by its geometry."""

    SIT_ON = "to sit on"
    PUT_ON = "to put things on"
    PUT_IN = "to put things in"


@dataclass(frozen=True, kw_only=True, slots=True)
class HasColor:
    """The object has a colour of `COLOR_NAMES`; its `share` of the points does not suffice, and suffices fully."""

    name: str
    share: tuple[float, float] = (0.2, 0.5)


@dataclass(frozen=True, kw_only=True, slots=True)
class HasShape:
    """The object has a shape of `SHAPE_WORDS`."""

    name: str


@dataclass(frozen=True, kw_only=True, slots=True)
class HasMeasure:
    """A quantity lies beyond a border: `zero_at` metres not at all, `one_at` fully; `name` is its wording."""

    name: str
    quantity: Quantity
    zero_at: float
    one_at: float


@dataclass(frozen=True, kw_only=True, slots=True)
class Sized:
    """Longer and shorter horizontal side and height lie in the ranges of things of this name, in metres."""

    name: str
    sides_m: tuple[tuple[float, float], ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Serves:
    """The object can be used in this way."""

    use: Use


@dataclass(frozen=True, kw_only=True, slots=True)
class ObjectOfId:
    """The object of the map with this id."""

    id: int


@dataclass(frozen=True, kw_only=True, slots=True)
class Place:
    """A place on the floor plan, metres in the map."""

    x: float
    y: float


Room = Literal["floor", "wall"]


@dataclass(frozen=True, kw_only=True, slots=True)
class Related:
    """The object has this relation to a landmark."""

    relation: Relation
    to: "Thing | ObjectOfId | Place | Room"


@dataclass(frozen=True, kw_only=True, slots=True)
class Most:
    """Of the objects that fulfil the rest, the one with the most, or the least, of a quantity.

    With `nearest_to` it is the nearest to that place.
    """

    name: str
    quantity: Quantity | None
    is_least: bool = False
    nearest_to: "Thing | ObjectOfId | Place | None" = None


@dataclass(frozen=True, kw_only=True, slots=True)
class Not:
    """An object that is not such a thing."""

    thing: "Thing"


@dataclass(frozen=True, kw_only=True, slots=True)
class Either:
    """An object that is one of some things; `name` is a word for all of them."""

    name: str
    things: "tuple[Thing, ...]"


@dataclass(frozen=True, kw_only=True, slots=True)
class LooksLike:
    """The object looks like a text, by an image-text network."""

    text: str


Condition = HasColor | HasShape | HasMeasure | Sized | Serves | Related | Most | Not | Either | LooksLike


@dataclass(frozen=True, kw_only=True, slots=True)
class Thing:
    """An object that fulfils all conditions."""

    conditions: tuple[Condition, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Question:
    """The objects asked for, or (`counts`) their number."""

    thing: Thing
    counts: bool


def phrase_of(part: Condition | Thing | ObjectOfId | Place | Room, *, brief: bool = False) -> str:
    """Return a condition or a landmark in words; `brief` leaves out sizes and alternatives."""
    phrase = partial(phrase_of, brief=brief)
    match part:
        case HasColor() | HasShape():
            return part.name
        case HasMeasure() | Most(nearest_to=None):
            return part.name
        case Most(nearest_to=landmark):
            assert landmark is not None
            return f"nearest to {phrase(landmark)}"
        case Sized():
            sides = " x ".join(f"{100 * low:.0f}-{100 * high:.0f}" for low, high in part.sides_m)
            return f"{part.name}-sized" if brief else f"{part.name}-sized ({sides} cm)"
        case Serves():
            return str(part.use)
        case Related():
            return f"{part.relation} {phrase(part.to)}"
        case LooksLike():
            return f'looks like "{part.text}"'
        case Either():
            return part.name if brief else " or ".join(map(phrase, part.things))
        case Not():
            return f"not {phrase(part.thing)}"
        case Thing():
            parts = ", ".join(map(phrase, part.conditions)) or "any object"
            return f"({parts})" if len(part.conditions) > 1 else parts
        case ObjectOfId():
            return f"#{part.id}"
        case Place():
            return f"{part.x:g},{part.y:g}"
        case _:
            return f"the {part}"
