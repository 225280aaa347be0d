"""Outlines of rooms: (K, 2) corners in metres, counter-clockwise, within or about a given size."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.clutter.draws import (
    uniform,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray


def outline_rectangle(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a plain room."""
    return np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size


def outline_l_shape(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room round a corner."""
    a, b = uniform(rng, 0.4, 0.7), uniform(rng, 0.4, 0.7)
    return np.array([[0, 0], [1, 0], [1, b], [a, b], [a, 1], [0, 1]]) * size


def outline_cut_corner(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room with one slanting wall."""
    a, b = uniform(rng, 0.4, 0.85), uniform(rng, 0.4, 0.85)
    return np.array([[0, 0], [1, 0], [1, b], [a, 1], [0, 1]]) * size


def outline_skewed(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return four walls of which no two are parallel."""
    shift = rng.uniform(-0.1, 0.1, size=(4, 2))
    return (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) + shift) * size


def outline_octagon(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room with four cut corners."""
    c = uniform(rng, 0.15, 0.35)
    corners = [[c, 0], [1 - c, 0], [1, c], [1, 1 - c], [1 - c, 1], [c, 1], [0, 1 - c], [0, c]]
    return np.array(corners) * size


def outline_bay(rng: np.random.Generator, size: tuple[float, float]) -> NDArray[np.float64]:
    """Return a room with a bay in one wall."""
    a, b, deep = uniform(rng, 0.1, 0.3), uniform(rng, 0.6, 0.9), uniform(rng, 0.15, 0.35)
    slope = uniform(rng, 0.0, 0.08)
    corners = [[0, 0], [1, 0], [1, 1], [b, 1], [b - slope, 1 + deep], [a + slope, 1 + deep], [a, 1], [0, 1]]
    return np.array(corners) * size


OUTLINES: dict[str, Callable[[np.random.Generator, tuple[float, float]], NDArray[np.float64]]] = {
    "rectangle": outline_rectangle,
    "l_shape": outline_l_shape,
    "cut_corner": outline_cut_corner,
    "skewed": outline_skewed,
    "octagon": outline_octagon,
    "bay": outline_bay,
}
"""The outlines of rooms by name; all are counter-clockwise."""
