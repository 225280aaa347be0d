"""The two voxel lattices of a map, of objects and of the observed space; perception and mapping share them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from numpy.typing import NDArray

STEPS_PER_M = 32768.0
"""Points lie at whole multiples of 2^-15 m, 31 um, along each axis: finer than any depth, and exact in float32 as far
as 512 m. So a point takes four bytes instead of twelve, and nothing is lost by storing it."""


def on_steps(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (N, 3) points at the nearest multiples of the step."""
    step = np.float32(STEPS_PER_M)
    # With 0.0 added there is no negative zero.
    return ((np.rint(points * step) + np.float32(0.0)) / step).astype(np.float32)


def steps_of(points: NDArray[Any]) -> NDArray[np.int32] | None:
    """Return (N, 3) points in steps, None where one does not lie at a multiple of them, or too far away."""
    with np.errstate(invalid="ignore", over="ignore"):
        steps = points * np.float32(STEPS_PER_M)
        if not ((steps == np.rint(steps)) & (np.abs(steps) < _MOST_STEPS)).all() or np.signbit(steps[steps == 0]).any():
            return None
    return steps.astype(np.int32)


def points_of(steps: NDArray[np.int32]) -> NDArray[np.float32]:
    """Return the points (N, 3) of which `steps_of` gave the steps."""
    return steps.astype(np.float32) / np.float32(STEPS_PER_M)


# Beyond it float32 does not tell one step from the next.
_MOST_STEPS = 1 << 24


@dataclass(frozen=True, kw_only=True, slots=True)
class Lattice(Ranged):
    """The sides of voxels, anchored at the world's origin.

    Attributes:
        points_m: of the points of objects: masks are lifted to means over these, and tracks keep one point in each; no
            box has lesser half extents.
        space_m: of the observed space, which rays pass through and structure fills.
    """

    points_m: float = number(0.01, 0.001, 1, "m")
    space_m: float = number(0.05, 0.005, 1, "m")
