"""The two voxel lattices of a map, of objects and of the observed space; perception and mapping share them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry.arrays import read_only
from hickory_stream.geometry.codecs.packing import array_of, signed

STEPS_PER_M = 32768.0
"""Points lie at whole multiples of 2^-15 m, 31 um, along each axis: finer than any depth, and exact in float32 as far
as 512 m. So a point takes four bytes instead of twelve, and nothing is lost by storing it."""

MESH_STEPS_PER_M = 8192.0
"""Vertices of meshes lie at multiples of 2^-13 m, 122 um: a hundredth of the cells that most of them are made in."""


def on_steps(points: NDArray[Any], steps_per_m: float = STEPS_PER_M) -> NDArray[np.float32]:
    """Return (N, 3) points at the nearest multiples of the step."""
    step = np.float32(steps_per_m)
    with np.errstate(invalid="ignore", over="ignore"):
        # With 0.0 added there is no negative zero.
        return ((np.rint(points.astype(np.float32, copy=False) * step) + np.float32(0.0)) / step).astype(np.float32)


def points_of(steps: NDArray[np.int32], steps_per_m: float = STEPS_PER_M) -> NDArray[np.float32]:
    """Return the points (N, 3) at multiples (N, 3) of the step."""
    return steps.astype(np.float32) / np.float32(steps_per_m)


def packed_points(points: NDArray[np.float32], steps_per_m: float = STEPS_PER_M) -> bytes | None:
    """Return the bytes (12 N) of (N, 3) points, changes in steps as `unsigned` counts; None off the steps."""
    out = np.empty(12 * len(points), dtype=np.uint8)
    return out.tobytes() if _pack_points(read_only(points), np.float32(steps_per_m), out) else None


def unpacked_steps(data: bytes, count: int) -> NDArray[np.int32]:
    """Return the (N, 3) steps of `packed_points`; raises ValueError where there are not as many."""
    return np.cumsum(signed(array_of(data, np.dtype("<u4"), (count, 3))), axis=0, dtype=np.int32)


# Beyond it float32 does not tell one step from the next.
_MOST_STEPS = 1 << 24


@kernel
def _pack_points(points, steps_per_m, out):
    plane = 3 * len(points)
    for axis in range(3):
        last = 0
        for i in range(len(points)):
            steps = points[i, axis] * steps_per_m
            if not abs(steps) < _MOST_STEPS or steps != np.rint(steps) or (steps == 0 and np.signbit(steps)):
                return False
            change = int(steps) - last
            last += change
            code = 2 * change if change >= 0 else -2 * change - 1
            at = axis * len(points) + i
            for byte in range(4):
                out[byte * plane + at] = (code >> (8 * byte)) & 255
    return True


@dataclass(frozen=True, kw_only=True, slots=True)
class Lattice(Ranged):
    """The sides of voxels, anchored at the world's origin."""

    #: Of the points of objects: masks are lifted to means over these, and tracks keep one point in each.
    object_m: float = number(0.01, 0.001, 1, "m")
    #: Of the observed space, which rays pass through and structure fills.
    space_m: float = number(0.05, 0.005, 1, "m")
