"""Which points decide whether a superquadric contains them all: those that none of the others dominates.

A superquadric with exponents up to 2 is convex and symmetric in its three planes. So what contains a point contains all
points that are no farther from any of the planes, and with the ball around the one the equal ball around the other. In
absolute local coordinates only the maximal points count: of the 8,000 vertices of a scanned box about 200. They are
found from the farthest along x to the nearest, with a staircase of those found: y rises along it, and z falls.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.compiled import numba


@numba.njit(cache=True, nogil=True)
def undominated(points):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return (N,) which of (N, 3) points, of coordinates of at least 0, have no other one beyond them in all three.

    Of equal points at least one is kept.
    """
    kept = np.zeros(len(points), np.bool_)
    stairs = new_stairs(len(points))
    count = 0
    for n in np.argsort(-points[:, 0], kind="mergesort"):
        at = place_of(stairs, count, points[n, 1])
        if at < count and stairs[at, 1] >= points[n, 2]:
            continue
        kept[n] = True
        count = put(stairs, count, at, points[n, 1], points[n, 2], 0.0)
    return kept


@numba.njit(cache=True, nogil=True)
def new_stairs(most):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return (most, 3) room for the steps of a staircase: y, z, and a number that goes with them."""
    return np.empty((most, 3))


@numba.njit(cache=True, nogil=True)
def place_of(stairs, count, y):  # type: ignore[no-untyped-def] # pragma: no cover
    """Return the first of `count` steps that reaches as far along y: if any dominates a point there, it does."""
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        if stairs[middle, 0] >= y:
            high = middle
        else:
            low = middle + 1
    return low


@numba.njit(cache=True, nogil=True)
def put(stairs, count, at, y, z, number):  # type: ignore[no-untyped-def] # pragma: no cover
    """Put a step that none dominates where `place_of` says, in place of those it dominates; return the new count."""
    first = at
    while first > 0 and stairs[first - 1, 1] <= z:
        first -= 1
    shift = first + 1 - at
    if shift > 0:
        for n in range(count - 1, at - 1, -1):
            for i in range(3):
                stairs[n + shift, i] = stairs[n, i]
    elif shift < 0:
        for n in range(at, count):
            for i in range(3):
                stairs[n + shift, i] = stairs[n, i]
    stairs[first, 0], stairs[first, 1], stairs[first, 2] = y, z, number
    return count + shift
