"""Questions about a world, made from its true meshes, and the true objects that answer each."""
# The conditions are computed from mesh geometry and mean colours here, by other code than a map's. A question is asked
# only where the truth is clear: every true object either fulfils it plainly or plainly does not.

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.evaluation.truth import Truth, mesh_of
from hickory_stream.geometry.mesh import face_areas_m2
from hickory_stream.geometry.rigid import apply

_MIN_SEEN = 0.3
_SEATS = ("chair", "armchair", "stool", "bench", "office_chair", "sofa")
# Hues, degrees of HSV, that a person calls so without doubt, of colours this strong.
_HUES = {"red": (345, 15), "green": (85, 165), "blue": (200, 250), "yellow": (48, 65), "purple": (275, 320)}
_CLEAR_SATURATION, _CLEAR_VALUE = 0.4, 0.2
_STAND_M, _NEAR_M, _FAR_M = 0.03, 0.4, 1.7


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class TrueThing:
    """A true object of which enough was seen: id, kind, median colour (3,) in 0..1, bounds (2, 3) of its mesh."""

    id: int
    kind: str
    color: NDArray[np.float64]
    bounds: NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, slots=True)
class TrueQuestion:
    """A question, and the ids of the true objects that answer it; none: it has no answer."""

    # `witnesses`: by an answer, sets of objects of each of which a map must hold one to know that it is an answer, e.g.
    # the red things on it of what carries something red.

    text: str
    answers: frozenset[int]
    witnesses: Mapping[int, tuple[frozenset[int], ...]]

    def is_held(self, held: Collection[int]) -> bool:
        """Return whether a map that holds these true objects can answer it; one without an answer every map can."""
        return not self.answers or any(
            answer in held and all(not some.isdisjoint(held) for some in self.witnesses[answer])
            for answer in self.answers
        )


@dataclass(frozen=True, kw_only=True, slots=True)
class _Condition:
    text: str
    test: Callable[[TrueThing], bool | None]
    holds_by: Callable[[TrueThing], frozenset[int]] | None = None


def true_questions(truth: Truth, count: int, rng: np.random.Generator) -> list[TrueQuestion]:
    things = [_thing(truth, i) for i in range(len(truth.objects)) if truth.objects[i].seen_fraction >= _MIN_SEEN]
    words = [*_words(), *relations(things)]
    found: dict[bool, list[TrueQuestion]] = {True: [], False: []}
    asked: set[str] = set()
    for _ in range(60 * count):
        chosen = [words[int(k)] for k in rng.choice(len(words), size=int(rng.integers(1, 3)), replace=False)]
        chosen.sort(key=lambda one: " " in one.text)
        head = [one.text for one in chosen if " " not in one.text]
        tail = [one.text for one in chosen if " " in one.text]
        text = " ".join([*head, "thing", " and ".join(tail)]).strip()
        held = [[one.test(thing) for one in chosen] for thing in things]
        unclear = any(None in row and False not in row for row in held)
        if text in asked or unclear:
            continue
        asked.add(text)
        answers = [thing for thing, row in zip(things, held, strict=True) if all(row)]
        witnesses = {
            thing.id: tuple(one.holds_by(thing) for one in chosen if one.holds_by is not None) for thing in answers
        }
        found[bool(answers)].append(TrueQuestion(text=text, answers=frozenset(witnesses), witnesses=witnesses))
    without = found[False][: count // 10]
    return [*found[True][: count - len(without)], *without]


def _words() -> list[_Condition]:
    return [
        *(_Condition(text=name, test=_has_hue(*ends)) for name, ends in _HUES.items()),
        _Condition(text="large", test=lambda one: _clear(float(_sides(one).max()), 1.1, 0.65)),
        _Condition(text="small", test=lambda one: _clear(-float(_sides(one).max()), -0.28, -0.48)),
        _Condition(text="tall", test=lambda one: _clear(float(_sides(one)[2]), 1.25, 0.75)),
        _Condition(text="taller than 0.6 m", test=lambda one: _clear(float(_sides(one)[2]), 0.7, 0.5)),
        _Condition(text="to sit on", test=lambda one: one.kind in _SEATS),
    ]


def relations(things: list[TrueThing]) -> list[_Condition]:
    found = [_Condition(text="on the floor", test=lambda one: _clear(-float(one.bounds[0, 2]), -0.02, -0.1))]
    for other in things:
        x, y = (float(part) for part in other.bounds.mean(axis=0)[:2].round(1))
        found.append(_Condition(text=f"near {x:g},{y:g}", test=partial(_is_near, x=x, y=y)))
    for word in _words()[: len(_HUES)]:
        plainly = partial(_carried, of=[one for one in things if word.test(one)])
        perhaps = partial(_carried, of=[one for one in things if word.test(one) is None])

        def test(one: TrueThing, plainly: Any = plainly, perhaps: Any = perhaps) -> bool | None:
            return True if plainly(one) else None if perhaps(one) else False

        found.append(_Condition(text=f"carrying something {word.text}", test=test, holds_by=plainly))
    return found


def _carried(one: TrueThing, of: Sequence[TrueThing]) -> frozenset[int]:
    return frozenset(other.id for other in of if _stands(other, one))


def _thing(truth: Truth, i: int) -> TrueThing:
    item = truth.objects[i]
    mesh = mesh_of(truth, item)
    world = apply(item.world_from_object, mesh.vertices.astype(np.float64))
    of_faces = (mesh.colors / 255)[mesh.faces].mean(axis=1)
    color = np.quantile(of_faces, 0.5, axis=0, weights=face_areas_m2(mesh), method="inverted_cdf")
    return TrueThing(id=item.id, kind=item.kind, color=color, bounds=np.array([world.min(axis=0), world.max(axis=0)]))


def _sides(one: TrueThing) -> NDArray[np.float64]:
    return np.asarray(one.bounds[1] - one.bounds[0])


def _clear(value: float, yes_from: float, no_below: float) -> bool | None:
    return True if value >= yes_from else False if value <= no_below else None


def _has_hue(low: float, high: float) -> Callable[[TrueThing], bool | None]:
    def test(one: TrueThing) -> bool | None:
        hue, saturation, value = cv2.cvtColor(one.color.astype(np.float32)[None, None], cv2.COLOR_RGB2HSV)[0, 0]
        away = min((hue - low) % 360, (high - hue) % 360) if (hue - low) % 360 > (high - low) % 360 else 0.0
        if away > 25:
            return False
        return True if away == 0 and saturation > _CLEAR_SATURATION and value > _CLEAR_VALUE else None

    return test


def _is_near(one: TrueThing, x: float, y: float) -> bool | None:
    here = np.array([x, y])
    away = np.maximum(np.maximum(one.bounds[0, :2] - here, here - one.bounds[1, :2]), 0.0)
    return _clear(-float(np.linalg.norm(away)), -_NEAR_M, -_FAR_M)


def _stands(upper: TrueThing, lower: TrueThing) -> bool:
    middle = upper.bounds.mean(axis=0)[:2]
    is_over = bool((middle > lower.bounds[0, :2]).all() and (middle < lower.bounds[1, :2]).all())
    return upper is not lower and is_over and abs(float(upper.bounds[0, 2] - lower.bounds[1, 2])) < _STAND_M
