"""The stairwell: from each storey a flight up to a landing half way, and a second one back up to the storey above."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Part, rounded_box
from hickory_stream.worlds.room import WALL_M
from hickory_stream.worlds.textures import Texture
from tools.worlds.building.plan import Outline
from tools.worlds.furnishing import Rectangle
from tools.worlds.structure import ROOM_HEIGHT_M, drawn_paint

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
        return np.array(
            [
                (x0 + _LANDING_M / 2, (y0 + y1) / 2, 0.0),
                (first, up, 0.0),
                (last, up, half),
                (x1 - _LANDING_M / 2, up, half),
                (x1 - _LANDING_M / 2, back, half),
                (last, back, half),
                (first, back, STOREY_M),
                (x0 + _LANDING_M / 2, (y0 + y1) / 2, STOREY_M),
            ]
        )

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
