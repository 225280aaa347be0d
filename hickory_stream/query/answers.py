"""The answer to a question: every object's degree in 0..1, and the objects at or above a half, best first.

The degree of several conditions is their minimum (Zadeh, 1965); ties go by the product, then the id.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import assert_never

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import InputError
from hickory_stream.query.colors import COLOR_NAMES
from hickory_stream.query.grammar import question_of
from hickory_stream.query.map_index import MapIndex
from hickory_stream.query.question import (
    Condition,
    Either,
    HasColor,
    HasMeasure,
    HasShape,
    LooksLike,
    Most,
    Not,
    ObjectOfId,
    Place,
    Quantity,
    Related,
    Serves,
    Sized,
    Thing,
    Use,
    phrase_of,
)
from hickory_stream.query.relations import distances_to, distances_to_place, related, related_to_place, related_to_room
from hickory_stream.query.shape_scores import LEVEL_M, NUM_LEVELS, SHAPE_WORDS, ramp

Looks = Callable[[str], NDArray[np.float64]]

ENOUGH = 0.5
# Beyond a range of sizes by this share, a thing is of another size.
_SIZE_SLACK = 0.25
# Heights of a level surface above the floor, and its area: not at all, fully.
_SEAT_M, _SEAT_M2 = (0.3, 0.6), (0.04, 0.09)
# Things are put on a top that is level and covers this share of the footprint.
_TOP_SHARE = (0.3, 0.6)


@dataclass(frozen=True, kw_only=True, slots=True)
class Answer:
    """An object that answers; `why` has each condition in words with its score in 0..1, `score` is the least."""

    id: int
    score: float
    why: tuple[tuple[str, float], ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Answers:
    """All objects that answer, best first; `nearly` are the best of the others.

    `by_looks`: an image-text network judged some of the conditions; otherwise geometry and colour did.
    """

    question: str
    counts: bool
    by_looks: bool
    found: tuple[Answer, ...]
    nearly: tuple[Answer, ...]

    @property
    def judged_by(self) -> str:
        """The sources of the answers in words."""
        return "geometry, colour and an image-text network" if self.by_looks else "geometry and colour alone"


@dataclass(frozen=True, kw_only=True, slots=True)
class _Asked:
    index: MapIndex
    viewer: tuple[float, float] | None
    looks: Looks | None


def ask(index: MapIndex, text: str, viewer: tuple[float, float] | None = None, looks: Looks | None = None) -> Answers:
    """Return the answers to a question in the grammar of `grammar.py`.

    Args:
        index: of the map.
        text: the question, e.g. "a red box on a table".
        viewer: viewpoint of "in front of" and "left of", metres in the map; None: the best viewpoint of the landmark.
        looks: returns (N,) in 0..1, the likeness of each object to a text (`ObjectLooks`); None: words that only a
            network knows are refused.

    Raises:
        InputError: an unknown word (`grammar.UnknownWord`), a landmark that is no object, or a meaningless relation.
    """
    question = question_of(text, with_looks=looks is not None)
    asked = _Asked(index=index, viewer=viewer, looks=looks)
    parts = _parts(asked, question.thing)
    scores, products = _together(parts, len(index))
    order = np.lexsort((index.ids, -products, -scores))
    ranked = [
        Answer(
            id=int(index.ids[i]),
            score=round(float(scores[i]), 4),
            why=tuple((phrase_of(condition, brief=True), round(float(degrees[i]), 4)) for condition, degrees in parts),
        )
        for i in order
    ]
    count = int((scores >= ENOUGH).sum())
    return Answers(
        question=phrase_of(question.thing),
        counts=question.counts,
        by_looks=looks is not None,
        found=tuple(ranked[:count]),
        nearly=tuple(answer for answer in ranked[count : count + 3] if answer.score > 0),
    )


def _parts(asked: _Asked, thing: Thing) -> list[tuple[Condition, NDArray[np.float64]]]:
    # Superlatives come last: they choose among objects that fulfil the other conditions.
    plain = [condition for condition in thing.conditions if not isinstance(condition, Most)]
    parts: list[tuple[Condition, NDArray[np.float64]]]
    parts = [(condition, _degrees(asked, condition)) for condition in plain]
    for condition in thing.conditions:
        if isinstance(condition, Most):
            scores, _ = _together(parts, len(asked.index))
            parts.append((condition, _foremost(asked, condition, scores >= ENOUGH)))
    return parts


def _together(
    parts: list[tuple[Condition, NDArray[np.float64]]], count: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    degrees = np.array([np.ones(count), *(degrees for _, degrees in parts)])
    return degrees.min(axis=0), degrees.prod(axis=0)


def _degrees(asked: _Asked, condition: Condition) -> NDArray[np.float64]:
    index = asked.index
    if isinstance(condition, HasColor):
        return ramp(index.colors[:, COLOR_NAMES.index(condition.name)], *condition.share)
    if isinstance(condition, HasShape):
        return index.shapes[:, SHAPE_WORDS.index(condition.name)]
    if isinstance(condition, HasMeasure):
        return ramp(_quantity_m(index, condition.quantity), condition.zero_at, condition.one_at)
    if isinstance(condition, Sized):
        lows, highs = np.array(condition.sides_m).T
        fits = np.minimum(index.sides_m / np.maximum(lows, 1e-6), highs / np.maximum(index.sides_m, 1e-6))
        return ramp(fits.min(axis=1), 1 - _SIZE_SLACK, 1.0)
    if isinstance(condition, Serves):
        return _serves(index, condition.use)
    if isinstance(condition, Related):
        return _related(asked, condition)
    if isinstance(condition, Not):
        return 1.0 - _together(_parts(asked, condition.thing), len(index))[0]
    if isinstance(condition, Either):
        return np.max([_together(_parts(asked, thing), len(index))[0] for thing in condition.things], axis=0)
    if isinstance(condition, Most):
        return _foremost(asked, condition, np.ones(len(index), bool))
    if isinstance(condition, LooksLike):
        assert asked.looks is not None, "the grammar lets looks pass only where they are allowed"
        return asked.looks(condition.text)
    assert_never(condition)


def _quantity_m(index: MapIndex, quantity: Quantity) -> NDArray[np.float64]:
    if quantity is Quantity.SIZE:
        return np.asarray(index.sides_m.max(axis=1, initial=0.0))
    if quantity is Quantity.UNDERSIDE:
        return index.bottom_m
    if quantity is Quantity.FIXED:
        return index.fixed
    if quantity is Quantity.SLENDERNESS:
        return np.asarray(index.sides_m[:, 2] / np.maximum(index.sides_m[:, 0], 1e-6))
    return index.sides_m[:, (Quantity.LENGTH, Quantity.WIDTH, Quantity.HEIGHT).index(quantity)]


def _serves(index: MapIndex, use: Use) -> NDArray[np.float64]:
    if use is Use.PUT_IN:
        return index.shapes[:, SHAPE_WORDS.index("hollow")]
    # What is level to within two steps is one surface.
    areas_m2 = index.levels_m2 + np.pad(index.levels_m2, ((0, 0), (0, 1)))[:, 1:]
    middles_m = (np.arange(NUM_LEVELS) + 0.5) * LEVEL_M
    if use is Use.SIT_ON:
        is_there = (middles_m > _SEAT_M[0]) & (middles_m < _SEAT_M[1])
        return ramp(np.max(areas_m2, axis=1, where=is_there, initial=0.0), *_SEAT_M2)
    below_top_m = (index.bottom_m + index.sides_m[:, 2])[:, None] - middles_m
    top_m2 = np.max(areas_m2, axis=1, where=np.abs(below_top_m) < 2 * LEVEL_M, initial=0.0)
    footprint_m2 = np.maximum(index.sides_m[:, 0] * index.sides_m[:, 1], 1e-6)
    return np.minimum(ramp(top_m2, *_SEAT_M2), ramp(top_m2 / footprint_m2, *_TOP_SHARE))


def _related(asked: _Asked, condition: Related) -> NDArray[np.float64]:
    index = asked.index
    relation, to = condition.relation, condition.to
    if isinstance(to, Thing | ObjectOfId):
        landmarks = _landmarks(asked, to)
        pairs = index.pairs
        degrees = np.minimum(related(index, pairs, relation, asked.viewer), landmarks[pairs.j])
        best = np.zeros(len(index))
        np.maximum.at(best, pairs.i, degrees)
        return best
    found = (
        related_to_place(index, relation, to.x, to.y) if isinstance(to, Place) else related_to_room(index, relation, to)
    )
    if found is None:
        raise InputError(f'found "{phrase_of(condition)}", expected near or beside {phrase_of(to)}, or on the floor')
    return found


def _foremost(asked: _Asked, condition: Most, is_among: NDArray[np.bool_]) -> NDArray[np.float64]:
    # 1 for the foremost object of `is_among`, less for others by their distance behind it.
    if condition.quantity is not None:
        values = np.maximum(_quantity_m(asked.index, condition.quantity), 1e-3)
    else:
        values = np.maximum(_distances_m(asked, condition), 1e-3)
    if not is_among.any():
        return np.zeros(len(asked.index))
    if condition.is_least or condition.quantity is None:
        return np.asarray(np.where(is_among, values[is_among].min() / values, 0.0))
    return np.asarray(np.where(is_among, values / values[is_among].max(), 0.0))


def _distances_m(asked: _Asked, condition: Most) -> NDArray[np.float64]:
    to = condition.nearest_to
    if isinstance(to, Place):
        return distances_to_place(asked.index, to.x, to.y)
    assert to is not None
    return distances_to(asked.index, np.flatnonzero(_landmarks(asked, to) >= ENOUGH))


def _landmarks(asked: _Asked, to: Thing | ObjectOfId) -> NDArray[np.float64]:
    if isinstance(to, Thing):
        return _together(_parts(asked, to), len(asked.index))[0]
    is_it = asked.index.ids == to.id
    if not is_it.any():
        raise InputError(f"found object {to.id}, which the map does not have; `hickory-stream inspect` lists them")
    return is_it.astype(np.float64)
