"""The floor plan of a storey: rooms on both sides of a corridor that leads to the stairs, and doors."""
# The corridor runs along x from 0. Its sections are rooms for lamps and looks. The stairwell is beyond its end.

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hickory_stream.worlds.room import WALL_M
from tools.worlds.furnishing import Rectangle
from tools.worlds.structure import DoorWay, drawn_door

_SECTION_M = 5.0
_DOORS_M = (0.95, 1.05)
# So many of the walls between two rooms have a door: loops that do not lead through the corridor.
_DOOR_SHARE = 0.35


@dataclass(frozen=True, kw_only=True, slots=True)
class Outline:
    """The corridor's length and width, and the depth of the rooms on either side, the same on all storeys."""

    length_m: float
    width_m: float
    depths_m: tuple[float, float]


@dataclass(frozen=True, kw_only=True, slots=True)
class StoreyPlan:
    """Rectangles (x0, y0, x1, y1) of rooms and sections of the corridor; the last of `doors` leads to the stairs."""

    outline: Outline
    rooms_m: tuple[Rectangle, ...]
    #: Of each room: 1 beyond the corridor's greatest y, 0 below its least.
    sides: tuple[int, ...]
    sections_m: tuple[Rectangle, ...]
    doors: tuple[DoorWay, ...]

    @property
    def stairs_door(self) -> DoorWay:
        return self.doors[-1]


def drawn_outline(rng: np.random.Generator, rooms: int) -> Outline:
    """Return the outline of storeys with a number of rooms, half of them on each side of the corridor."""
    per_side = (rooms + 1) // 2
    return Outline(
        length_m=per_side * float(rng.uniform(4.4, 5.0)) + (per_side - 1) * WALL_M,
        width_m=float(rng.uniform(2.3, 2.5)),
        depths_m=(float(rng.uniform(4.2, 4.9)), float(rng.uniform(4.2, 4.9))),
    )


def drawn_plan(rng: np.random.Generator, outline: Outline, rooms: int) -> StoreyPlan:
    rectangles: list[Rectangle] = []
    sides: list[int] = []
    doors: list[DoorWay] = []
    for side, count in enumerate((rooms // 2, rooms - rooms // 2)):
        low, high = _span(outline, side)
        wall_y = -WALL_M / 2 if side == 0 else outline.width_m + WALL_M / 2
        ends = _split(rng, outline.length_m, count)
        for i, (x0, x1) in enumerate(ends):
            rectangles.append((x0, low, x1, high))
            sides.append(side)
            doors.append(drawn_door(rng, _DOORS_M, axis=1, at_m=wall_y, span_m=(x0, x1)))
            if i and rng.random() < _DOOR_SHARE:
                doors.append(drawn_door(rng, _DOORS_M, axis=0, at_m=x0 - WALL_M / 2, span_m=(low, high)))
    doors.append(DoorWay(axis=0, at_m=outline.length_m + WALL_M / 2, middle_m=outline.width_m / 2, width_m=1.1))
    return StoreyPlan(
        outline=outline,
        rooms_m=tuple(rectangles),
        sides=tuple(sides),
        sections_m=_sections(outline),
        doors=tuple(doors),
    )


def _span(outline: Outline, side: int) -> tuple[float, float]:
    if side == 0:
        return -WALL_M - outline.depths_m[0], -WALL_M
    return outline.width_m + WALL_M, outline.width_m + WALL_M + outline.depths_m[1]


def _split(rng: np.random.Generator, length_m: float, count: int) -> list[tuple[float, float]]:
    shares = rng.uniform(0.85, 1.15, size=count)
    widths = shares / shares.sum() * (length_m - (count - 1) * WALL_M)
    starts = np.concatenate([[0.0], np.cumsum(widths + WALL_M)[:-1]])
    return [(float(start), float(start + width)) for start, width in zip(starts, widths, strict=True)]


def _sections(outline: Outline) -> tuple[Rectangle, ...]:
    count = max(1, round(outline.length_m / _SECTION_M))
    edges = np.linspace(0.0, outline.length_m, count + 1)
    return tuple((float(a), 0.0, float(b), outline.width_m) for a, b in pairwise(edges))
