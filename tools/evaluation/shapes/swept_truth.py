"""The clearance of a swept body from a superquadric by slow search: the reference of the sweep kernels."""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.superquadric import Superquadrics, support, world_bounds

_NET = 1500
_AROUND = 40


def swept_distance_m(
    primitives: Superquadrics, start: NDArray[np.float64], end: NDArray[np.float64],
    half_extents_m: NDArray[np.float64], *, reach_m: float,
) -> float:  # fmt: skip
    """Return how near the box moved from `start` to `end` (3,) comes to any primitive, at most `reach_m`."""
    # Below 0 where it touches, then without the depth. To about a micrometre.
    bounds = world_bounds(primitives)
    low = np.minimum(start, end) - half_extents_m - reach_m
    high = np.maximum(start, end) + half_extents_m + reach_m
    near = np.flatnonzero(((bounds[:, 0] <= high) & (bounds[:, 1] >= low)).all(axis=1))
    return min([reach_m, *(_widest_slab(primitives, int(i), start, end, half_extents_m) for i in near)])


def _widest_slab(
    primitives: Superquadrics, index: int, start: NDArray[np.float64], end: NDArray[np.float64],
    half: NDArray[np.float64],
) -> float:  # fmt: skip
    # The widest slab, by duality the distance: without local maxima above 0 over directions, so a net over the sphere,
    # then shrinking nets.
    rng = np.random.default_rng(index)
    directions, width = _sphere(_NET), 0.1
    best, at = -np.inf, directions[0]
    while width > 1e-7:
        apart = np.minimum(directions @ start, directions @ end) - np.abs(directions) @ half
        apart -= support(primitives, index, directions)
        i = int(np.argmax(apart))
        if apart[i] > best + 1e-9:
            best, at = float(apart[i]), directions[i]
        else:
            width /= 2
        directions = at + width * rng.normal(size=(_AROUND, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return best


def _sphere(count: int) -> NDArray[np.float64]:
    steps = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * steps / count), np.pi * (1 + 5**0.5) * steps
    return np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)], axis=1)
