"""Where a robot can stand beside an object: the goal of a way to it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.rigid import apply, invert

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.geometry.boxes import OrientedBox
    from hickory_stream.navigation.free_space import FreeSpace

# Farther from the object's box than this, beyond its own reach, a robot does not stand beside it.
_BESIDE_M = 0.6


def place_beside(space: FreeSpace, start: NDArray[np.float64], box: OrientedBox) -> NDArray[np.float64] | None:
    """Return the place (2,) nearest to an object that can be reached from `start` (2,), None if none is beside it.

    Of equally near places, to within a cell, it is the one nearest to the start. Cells that are connected with the
    start count, so that a path to the place is likely, but not proven: a robot that is no disc has to turn.
    """
    frame = space.frame
    cells, _ = space.reachable_cells((start - frame.origin_m) / frame.cell_m)
    if not len(cells):
        return None
    places = frame.origin_m + (cells[:, ::-1] + 0.5) * frame.cell_m
    local = apply(invert(box.world_from_box), np.column_stack([places, np.full(len(places), box.center[2])]))
    away = np.linalg.norm(np.maximum(np.abs(local[:, :2]) - box.half_extents_m[:2], 0.0), axis=1)
    rounds = np.floor(away / frame.cell_m)
    best = int(np.lexsort((np.linalg.norm(places - start, axis=1), rounds))[0])
    return places[best] if away[best] <= space.robot.reach_m + _BESIDE_M else None
