"""Wider obstacles for objects that tend to move, so that a path avoids the places to which they may go."""

from collections.abc import Collection
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.geometry.superquadric import joined
from hickory_stream.navigation.free_space import FreeSpace
from hickory_stream.navigation.stand_ins import box_as_superquadric
from hickory_stream.records import MapSnapshot

_STEP_M = 0.05


def keep_off(space: FreeSpace, snapshot: MapSnapshot, ids: Collection[int], berth_m: float) -> None:
    """Make objects wider obstacles: their body, and their box with `berth_m` on every side."""
    for item in snapshot.objects:
        if item.id in ids:
            wide = box_as_superquadric(item.box, berth_m)
            body = None if item.shape is None or not len(item.shape.inflated) else item.shape.inflated
            space.put(item.id, wide if body is None else joined([body, wide]))


def passed_by(points: NDArray[np.float64], snapshot: MapSnapshot, ids: Collection[int], within_m: float) -> list[int]:
    """Return which objects a path with corners (N, 2) passes within `within_m` of their boxes, as seen from above."""
    steps = [max(2, int(np.linalg.norm(b - a) / _STEP_M) + 1) for a, b in pairwise(points)]
    legs = [np.linspace(a, b, count) for (a, b), count in zip(pairwise(points), steps, strict=True)]
    way = np.concatenate(legs or [points])
    near = []
    for item in snapshot.objects:
        if item.id not in ids:
            continue
        at = np.column_stack([way, np.full(len(way), item.box.center[2])])
        outside = np.abs(apply(invert(item.box.world_from_box), at)) - item.box.half_extents_m
        if np.linalg.norm(np.maximum(outside, 0.0), axis=1).min() < within_m:
            near.append(item.id)
    return near
