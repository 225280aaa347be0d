"""Lights of a random room: several lamps of different colour temperature and brightness, with and without shadows."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.clutter.draws import count, log_uniform, uniform
from hickory_stream.worlds.lighting import Lamp, Lighting

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.textures import Color


def random_lighting(rng: np.random.Generator, outline_m: NDArray[np.float64], height_m: float) -> Lighting:
    """Return one to four lamps within a room, some of them low, and matching ambient light."""
    number = count(rng, 1, 4)
    low, high = outline_m.min(axis=0), outline_m.max(axis=0)
    places = np.empty((1, number, 3))
    places[0, :, :2] = low + rng.uniform(0.05, 0.95, size=(number, 2)) * (high - low)
    places[0, :, 2] = rng.uniform(0.6, 0.97, size=number) * height_m
    level = log_uniform(rng, 0.5, 1.6)
    lamps = tuple(
        Lamp(
            color=_tone(rng, level * uniform(rng, 0.4, 1.2) / np.sqrt(number)),
            near=uniform(rng, 0.4, 1.0),
            far=uniform(rng, 0.02, 0.25),
            shadow=uniform(rng, 0.05, 0.6),
        )
        for _ in range(number)
    )
    ambient = uniform(rng, 0.15, 0.6)
    return Lighting(
        places_m=places, lamps=lamps, num_shadows=min(number, count(rng, 1, 2)), ambient=_tone(rng, ambient)
    )


def _tone(rng: np.random.Generator, level: float) -> Color:
    """Return a colour of light between candle and sky."""
    warm = float(rng.normal(0, 0.1))
    return level * (1 + warm), level, level * (1 - warm)
