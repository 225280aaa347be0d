"""Which objects and structure occupy a cell of a robot's grid, and their distances."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from hickory_stream.navigation.outline import outlines_of_hulls, outlines_of_rows
from hickory_stream.navigation.robot import Part
from hickory_stream.navigation.stand_ins import SEEN_SURFACE

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.navigation.free_space import FreeSpace


@dataclass(frozen=True, kw_only=True, slots=True)
class Blocker:
    """An object, or the observed structure (`object_id` None), that a robot at a place would collide with.

    `is_observed_only`: in a live run, a provisional obstacle from the observed points of an object without layer 4;
    `SEEN_SURFACE` is observed surface that belongs to no object yet. `distance_m`: horizontal distance from the place
    to the part of the obstacle at the robot's heights; 0 inside.
    """

    object_id: int | None
    distance_m: float
    is_observed_only: bool = False

    @property
    def text(self) -> str:
        """The obstacle and its distance, as text for people."""
        name = "a wall" if self.object_id is None else f"object {self.object_id}"
        if self.is_observed_only:
            name = "something seen" if self.object_id == SEEN_SURFACE else f"{name} (observed only)"
        return f"{name}, {self.distance_m:.2f} m away" if self.distance_m > 0 else f"{name}, which is there"


def blockers_at(space: FreeSpace, place: NDArray[np.float64]) -> tuple[Blocker, ...]:
    """Return the obstacles that a robot at (2,) collides with in some posture and heading, the nearest first."""
    ((row, column),) = space.frame.cells_of(place[None]).tolist()
    layers = space.all_layers()
    ids = sorted({object_id for layer in layers for object_id in layer.objects_at(row, column)})
    # For a body without width, as high as the robot, the configuration-space outlines are the obstacles' own.
    low_m, high_m = space.heights_m
    slim = Part(low_m=low_m, high_m=high_m)
    early = {*space.observed_only, SEEN_SURFACE}
    found = [
        Blocker(object_id=i, distance_m=_distance_m(place, *_outlines(space, i, slim)), is_observed_only=i in early)
        for i in ids
    ]
    if any(layer.is_wall_at(row, column) for layer in layers):
        apart_m = _distance_m(place, *outlines_of_hulls(space.walls, slim))
        found.append(Blocker(object_id=None, distance_m=apart_m))
    return tuple(sorted(found, key=lambda blocker: blocker.distance_m))


def _outlines(space: FreeSpace, object_id: int, part: Part) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    if object_id in space.hulls:
        return outlines_of_hulls(space.hulls[object_id], part)
    return outlines_of_rows(space.scene.rows(object_id), part)


def _distance_m(place: NDArray[np.float64], corners: NDArray[np.float64], starts: NDArray[np.int64]) -> float:
    """Return the distance from a place to the nearest of some convex outlines, 0 inside one."""
    import cv2
    import numpy as np

    here = (0.0, 0.0)
    inside_m = [
        # Relative to the place: single precision is enough there.
        cv2.pointPolygonTest((corners[first:last] - place).astype(np.float32)[:, None], here, measureDist=True)
        for first, last in pairwise(starts.tolist())
        if last > first
    ]
    return max(0.0, -max(inside_m, default=-np.inf))
