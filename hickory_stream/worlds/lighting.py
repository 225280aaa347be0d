"""The lamps of a world: each room has the same number, of which the first ones cast shadows.

Light adds up linearly: under light 1, a white surface is rendered white.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.arrays import freeze
from hickory_stream.worlds.textures import Color

MOST_LAMPS = 8
"""The lamps that reach a pixel are kept in this number of bits."""
# Place of a room's two lamps under the ceiling, as shares of the half room, and their height; the first throws shadows.
_MAIN_LIGHT = (0.25, -0.2, 2.45)
_FILL_LIGHT = (-0.7, 0.6, 2.2)


@dataclass(frozen=True, kw_only=True, slots=True)
class Lamp:
    """A lamp: `color` (red, green, blue) is its strength."""

    color: Color
    #: Light falls off as 1 / (near + far d^2), d in metres.
    near: float = 0.6
    far: float = 0.16
    #: The share of its light that reaches shadowed surfaces by scattering.
    shadow: float = 0.45


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Lighting:
    """`places_m` (R, L, 3): the places of the L `lamps` in each of R rooms; the first `num_shadows` throw shadows."""

    places_m: NDArray[np.float64]
    lamps: tuple[Lamp, ...]
    num_shadows: int = 1
    ambient: Color = (0.5, 0.5, 0.5)
    #: The colour of rays without a hit.
    sky: Color = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        freeze(self, "places_m", np.float64, (None, len(self.lamps), 3))
        assert 0 <= self.num_shadows <= len(self.lamps) <= MOST_LAMPS


def usual_lighting(rooms_m: Sequence[tuple[float, float, float, float]]) -> Lighting:
    """Return a main lamp, which throws shadows, and a fill lamp in each room."""
    rooms = np.array(rooms_m, dtype=np.float64)
    middle, half = (rooms[:, :2] + rooms[:, 2:]) / 2, (rooms[:, 2:] - rooms[:, :2]) / 2
    places = np.empty((len(rooms), 2, 3))
    for i, place in enumerate((_MAIN_LIGHT, _FILL_LIGHT)):
        places[:, i, :2] = middle + half * place[:2]
        places[:, i, 2] = place[2]
    return Lighting(places_m=places, lamps=(Lamp(color=(0.95, 0.95, 0.95)), Lamp(color=(0.4, 0.4, 0.4))))


def lamp_table(lighting: Lighting) -> NDArray[np.float64]:
    """Return (R, L, 9) rows for the kernels: place, colour, near, far, share of light in the shadow."""
    rows = np.array([(*lamp.color, lamp.near, lamp.far, lamp.shadow) for lamp in lighting.lamps])
    rooms = len(lighting.places_m)
    return np.concatenate([lighting.places_m, np.broadcast_to(rows, (rooms, *rows.shape))], axis=2)
