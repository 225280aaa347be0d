"""Frames of robots while their maps grow.

After every round the grown maps are aligned with the others. Two equal answers in a row join two robots, unless other
joins contradict; a later answer can withdraw a join. The finished maps decide in the end (`finish`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.answer import Alignment, NoAlignment
from hickory_stream.alignment.object_map import ObjectMap, object_map
from hickory_stream.alignment.registration import differs
from hickory_stream.fleet.growth import Round
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.merging.groups import groups_of
from hickory_stream.merging.joining import JoiningConfig, aligned_to_join

# What may lie between two answers that say the same, as where a log is found in a map.
_AGREE_M, _AGREE_RAD = 0.3, np.radians(3.0)


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Frame:
    """Robots in one frame, defined by the first: names, frame_from_robot (4, 4) of each, and the joined pairs."""

    names: tuple[str, ...]
    frame_from_robot: tuple[NDArray[np.float64], ...]
    pairs: tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class JoinEvent:
    """A join of two robots, or its withdrawal, after `keyframe` keyframes.

    `a_from_b` (4, 4) is the alignment, `num_pairs` its matched objects, `sigma_m` its standard deviation.
    """

    keyframe: int
    kind: Literal["joined", "withdrawn"]
    a: str
    b: str
    a_from_b: NDArray[np.float64]
    num_pairs: int
    sigma_m: float

    def __post_init__(self) -> None:
        freeze(self, "a_from_b", np.float64, (4, 4))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Joint:
    """Frames of all robots with a map after a round, and the new events."""

    keyframe: int
    frames: tuple[Frame, ...]
    events: tuple[JoinEvent, ...]


class Joins:
    """Alignments of each two robots and their joins; `joining` is the required certainty."""

    def __init__(self, joining: JoiningConfig | None = None) -> None:
        self._joining = joining
        self._answers: dict[tuple[str, str], Alignment | NoAlignment] = {}
        self._confirmed: dict[tuple[str, str], Alignment] = {}
        self._joined: dict[tuple[str, str], Alignment] = {}
        self._maps: dict[str, ObjectMap] = {}

    def update(self, found: Round) -> Joint:
        """Return the frames after a round."""
        for name in found.grown:
            self._maps[name] = object_map(found.maps[name].snapshot, found.maps[name].extractor)
        names = tuple(found.maps)
        for pair in combinations(names, 2):
            if pair[0] in found.grown or pair[1] in found.grown:
                self._align(pair)
        frames = self._frames(found, names)
        return Joint(keyframe=found.keyframe, frames=frames, events=self._events(found.keyframe, frames))

    def _align(self, pair: tuple[str, str]) -> None:
        before = self._answers.get(pair)
        answer = aligned_to_join(self._maps[pair[0]], self._maps[pair[1]], self._joining)
        self._answers[pair] = answer
        if isinstance(answer, Alignment) and isinstance(before, Alignment) and _agree(answer, before):
            self._confirmed[pair] = answer
        else:
            self._confirmed.pop(pair, None)

    def _frames(self, found: Round, names: tuple[str, ...]) -> tuple[Frame, ...]:
        place = {name: i for i, name in enumerate(names)}
        answers = {(place[a], place[b]): answer for (a, b), answer in self._confirmed.items()}
        groups = groups_of([found.maps[name].snapshot for name in names], answers)
        return tuple(
            Frame(
                names=tuple(names[i] for i in group.members),
                frame_from_robot=group.group_from_map,
                pairs=tuple((names[a], names[b]) for a, b in group.pairs),
            )
            for group in groups
        )

    def _events(self, keyframe: int, frames: tuple[Frame, ...]) -> tuple[JoinEvent, ...]:
        joined = {pair: self._confirmed[pair] for frame in frames for pair in frame.pairs}
        new = [_event(keyframe, "joined", pair, joined[pair]) for pair in joined if pair not in self._joined]
        gone = [_event(keyframe, "withdrawn", pair, a) for pair, a in self._joined.items() if pair not in joined]
        self._joined = joined
        return (*new, *gone)


def joined_since(events: Sequence[JoinEvent], a: str, b: str) -> int | None:
    """Return the keyframe of the last join of two robots that holds, None without one while they moved."""
    parts = [event for event in events if {event.a, event.b} == {a, b}]
    return parts[-1].keyframe if parts and parts[-1].kind == "joined" else None


def _agree(answer: Alignment, before: Alignment) -> bool:
    center_b = apply(invert(answer.a_from_b), answer.center_a)
    return not differs(answer.a_from_b, before.a_from_b, center_b, distance_m=_AGREE_M, angle_rad=_AGREE_RAD)


def _event(keyframe: int, kind: Literal["joined", "withdrawn"], pair: tuple[str, str], answer: Alignment) -> JoinEvent:
    return JoinEvent(
        keyframe=keyframe,
        kind=kind,
        a=pair[0],
        b=pair[1],
        a_from_b=answer.a_from_b,
        num_pairs=len(answer.pairs),
        sigma_m=answer.translation_sigma_m,
    )
