"""Placement of models: with their back to a wall, or at random on a support surface."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.worlds.object_models import Model, Surface
from hickory_stream.worlds.scene import Placement, at_place

# Objects are placed half a millimetre above their support: of two coincident surfaces, a ray may hit either.
REST_M = 0.0005


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Wall:
    """A wall: its frame has the origin mid-wall on the floor, x into the room, y along the wall."""

    world_from_wall: NDArray[np.float64]
    half_m: float

    def place(self, model: Model, *, away_m: float, along_m: float, turn_rad: float = 0.0) -> Placement:
        """Return the model with its back `away_m` from the wall, `along_m` from the wall's middle."""
        x = away_m - float(model.bounds_m()[0, 0])
        return Placement(model=model, world_from_object=self.world_from_wall @ at_place(x, along_m, REST_M, turn_rad))


def walls_of(room_m: tuple[float, float, float, float]) -> list[Wall]:
    """Return the walls of a rectangle (x0, y0, x1, y1): at its least x, its greatest x, its least y, its greatest y."""
    x0, y0, x1, y1 = room_m
    x, y, half_x, half_y = (x0 + x1) / 2, (y0 + y1) / 2, (x1 - x0) / 2, (y1 - y0) / 2
    return [
        Wall(world_from_wall=at_place(x0, y, 0.0, 0.0), half_m=half_y),
        Wall(world_from_wall=at_place(x1, y, 0.0, np.pi), half_m=half_y),
        Wall(world_from_wall=at_place(x, y0, 0.0, np.pi / 2), half_m=half_x),
        Wall(world_from_wall=at_place(x, y1, 0.0, -np.pi / 2), half_m=half_x),
    ]


def stood_on(
    rng: np.random.Generator,
    support: Placement,
    surface: Surface,
    models: Sequence[Model],
    *,
    turn_rad: float = np.pi,
    beside: Sequence[Placement] = (),
    gap_m: float = 0.04,
) -> list[Placement]:
    """Return the models placed on a surface at random, at least `gap_m` apart, rotated by up to `turn_rad`.

    A model for which 60 draws find no place is left out.
    """
    placed: list[Placement] = []
    for model in models:
        lower, upper = model.bounds_m()
        if upper[2] > surface.headroom_m:
            continue
        reach = np.maximum(np.abs(lower[:2]), np.abs(upper[:2]))
        # A freely rotated model needs its radius, an aligned one its half width.
        need = reach if turn_rad < 0.5 else np.full(2, float(np.linalg.norm(reach)) * 0.85)
        room = np.maximum(np.asarray(surface.half_m) - need, 0.0)
        for _ in range(60):
            x, y = surface.center_m[:2] + room * rng.uniform(-1, 1, size=2)
            yaw = float(rng.uniform(-turn_rad, turn_rad))
            support_from_model = at_place(float(x), float(y), surface.center_m[2] + REST_M, yaw)
            one = Placement(model=model, world_from_object=support.world_from_object @ support_from_model)
            if one.fits([*placed, *beside], gap_m):
                placed.append(one)
                break
    return placed
