"""The floor plan of a storey: rooms on both sides of a corridor that leads to the stairs, and doors."""
# The stairwell: from each storey a flight up to a landing half way, and a second one back up to the storey above. The
# corridor runs along x from 0. Its sections are rooms for lamps and looks. The stairwell is beyond its end.

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Part, rounded_box
from hickory_stream.worlds.room import WALL_M
from hickory_stream.worlds.textures import Texture
from tools.worlds.furnishing import Rectangle
from tools.worlds.structure import ROOM_HEIGHT_M, DoorWay, drawn_door, drawn_paint

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
        outline=outline, rooms_m=tuple(rectangles), sides=tuple(sides), sections_m=_sections(outline),
        doors=tuple(doors),
    )  # fmt: skip


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


STOREY_M = ROOM_HEIGHT_M + 2 * WALL_M
"""From one floor to the next: a room, its ceiling and the floor above it."""
_STEPS = 8
_TREAD_M = 0.28
_LANDING_M = 1.2
_FLIGHT_M = 1.05
_CELL_M = 0.3
_UNDER_DOOR_M = WALL_M / 2
# The highest step of a flight is level with its landing.
_RUN_M = _STEPS * _TREAD_M


@dataclass(frozen=True, kw_only=True, slots=True)
class Stairwell:
    """The rectangle of the stairwell between its walls, for a building with an outline."""

    rectangle_m: Rectangle

    @staticmethod
    def beyond(outline: Outline) -> "Stairwell":
        x0 = outline.length_m + WALL_M
        return Stairwell(rectangle_m=(x0, 0.0, x0 + 2 * _LANDING_M + _RUN_M, outline.width_m))

    def way_up_m(self) -> NDArray[np.float64]:
        """Return (K, 3) corners of the way from the middle of one storey's landing, at z = 0, to that above."""
        x0, y0, x1, y1 = self.rectangle_m
        up, back = y0 + _FLIGHT_M / 2, y1 - _FLIGHT_M / 2
        first, last = x0 + _LANDING_M, x1 - _LANDING_M
        half = STOREY_M / 2
        return np.array([
            (x0 + _LANDING_M / 2, (y0 + y1) / 2, 0.0), (first, up, 0.0), (last, up, half),
            (x1 - _LANDING_M / 2, up, half), (x1 - _LANDING_M / 2, back, half), (last, back, half),
            (first, back, STOREY_M), (x0 + _LANDING_M / 2, (y0 + y1) / 2, STOREY_M),
        ])  # fmt: skip

    def structure(self, rng: np.random.Generator, storeys: int) -> tuple[Model, ...]:
        """Return its walls, floor, ceiling, landings and flights, for all storeys in the frame of the lowest."""
        x0, y0, x1, y1 = self.rectangle_m
        paint, stone = drawn_paint(rng), _stone(rng)
        height = storeys * STOREY_M - WALL_M
        middle = ((x0 + x1) / 2, (y0 + y1) / 2)
        side, end = (x1 - x0 + WALL_M, WALL_M, height), (WALL_M, y1 - y0 + 2 * WALL_M, height)
        walls = [_block(side, (middle[0], y, height / 2), paint) for y in (y0 - WALL_M / 2, y1 + WALL_M / 2)]
        walls.append(_block(end, (x1 + WALL_M / 2, middle[1], height / 2), paint))
        # Above the doors of the corridors, between one storey's walls and the next one's.
        walls += [
            _block((WALL_M, y1 - y0, 2 * WALL_M), (x0 - WALL_M / 2, middle[1], level * STOREY_M - WALL_M), paint)
            for level in range(1, storeys)
        ]
        # The ground and the landings reach half way under the doors, as the floors of the corridors do.
        length = x1 - x0 + _UNDER_DOOR_M
        floor = _block((length, y1 - y0, WALL_M), (x1 - length / 2, middle[1], -WALL_M / 2), stone)
        ceiling = _block((x1 - x0, y1 - y0, WALL_M), (*middle, height + WALL_M / 2 - WALL_M), paint)
        models = [Model(kind="wall", parts=(part,)) for part in walls]
        models += [Model(kind="floor", parts=(floor,)), Model(kind="ceiling", parts=(ceiling,))]
        for level in range(storeys - 1):
            models.append(Model(kind="stairs", parts=tuple(self._flights(level * STOREY_M, stone, paint))))
        models += [Model(kind="floor", parts=(self._landing(level * STOREY_M, stone),)) for level in range(1, storeys)]
        return tuple(models)

    def _landing(self, z: float, stone: Texture) -> Part:
        x0, y0, _, y1 = self.rectangle_m
        length = _LANDING_M + _UNDER_DOOR_M
        return _block((length, y1 - y0, WALL_M), (x0 + _LANDING_M - length / 2, (y0 + y1) / 2, z - WALL_M / 2), stone)

    def _flights(self, z: float, stone: Texture, paint: Texture) -> list[Part]:
        x0, y0, x1, y1 = self.rectangle_m
        first, last = x0 + _LANDING_M, x1 - _LANDING_M
        rise = STOREY_M / 2 / _STEPS
        half = z + STOREY_M / 2
        parts = [_block((_LANDING_M, y1 - y0, WALL_M), (x1 - _LANDING_M / 2, (y0 + y1) / 2, half - WALL_M / 2), stone)]
        for i in range(_STEPS):
            up, back = first + (i + 0.5) * _TREAD_M, last - (i + 0.5) * _TREAD_M
            for x, y, foot in ((up, y0 + _FLIGHT_M / 2, z), (back, y1 - _FLIGHT_M / 2, half)):
                # Each step reaches down behind the one below it, so that the flight is closed from beneath.
                parts.append(_block((_TREAD_M, _FLIGHT_M, 2 * rise), (x, y, foot + i * rise), stone))
        width = y1 - y0 - 2 * _FLIGHT_M
        parts.append(
            _block((last - first, width - 0.02, STOREY_M), ((first + last) / 2, (y0 + y1) / 2, z + STOREY_M / 2), paint)
        )
        return parts


def _block(size: tuple[float, float, float], at: tuple[float, float, float], texture: Texture) -> Part:
    return rounded_box(size, texture, at=at, radius_m=0.001, cell_m=_CELL_M)


def _stone(rng: np.random.Generator) -> Texture:
    grey = float(rng.uniform(0.5, 0.62))
    return Texture(
        pattern="plain", first=(grey, grey, grey * 0.97), second=(grey * 0.8, grey * 0.8, grey * 0.78), period_m=0.2,
        grain=0.15,
    )  # fmt: skip
