"""The occupancy of a map that grows, as a stream: a whole grid first, then the windows that changed.

An object is stamped again only when its layer 4 (or, without one, its box) is another one; walls and unknown space
every few snapshots, since the whole observed space is looked through for them. The grid grows in steps of metres; when
it does, the next message is a whole one again. In a live run it is early: what has no layer 4 yet has a stand-in.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.navigation.free_space import bodies_of, extent_of, floor_of
from hickory_stream.navigation.observed import Band, seen_columns, unknown_hulls
from hickory_stream.navigation.occupancy import GridFrame, Occupancy, frame_around
from hickory_stream.navigation.robot import Part
from hickory_stream.navigation.stand_ins import SEEN_SURFACE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from hickory_stream.navigation.robot import Robot
    from hickory_stream.navigation.stand_ins import Obstacle, SeenSurface
    from hickory_stream.records import MapSnapshot

_ROOM_M = 2.0
_FLOOR_MOVED_M = 0.02


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class CostmapUpdate:
    """Part of a grid: `states` (h, w) as `Cell`, from `row` and `column` on; all of it where `is_whole`."""

    stamp_ns: int
    frame: GridFrame
    row: int
    column: int
    states: NDArray[np.int8]
    is_whole: bool

    def __post_init__(self) -> None:
        freeze(self, "states", np.int8, (None, None))


class Costmap:
    """Follows the snapshots of a run; obstacles at the heights of a robot, in any posture, without its footprint.

    `seen`: what was seen in a live run, in which nothing waits to be sure; whoever calls adds to it.
    """

    def __init__(self, robot: Robot, *, cell_m: float, observe_every: int = 5, seen: SeenSurface | None = None) -> None:
        self._seen = seen
        self._heights_m = robot.heights_m
        self._cell_m = cell_m
        self._observe_every = observe_every
        self._grid: Occupancy | None = None
        self._band = Band(low_m=0.0, high_m=0.0)
        self._floor_m = 0.0
        self._known: dict[int, object] = {}
        self._sent: NDArray[np.int8] | None = None
        self._since_observed = 0

    def update(self, snapshot: MapSnapshot) -> CostmapUpdate | None:
        """Return what changed with a snapshot, None for nothing."""
        obstacles = bodies_of(snapshot, early=self._seen is not None)
        try:
            low, high = extent_of(snapshot, obstacles)
        except InputError:
            return None  # nothing was seen yet
        floor = floor_of(snapshot)
        grid = self._grid
        if grid is None or not _holds(grid.frame, low, high) or abs(floor - self._floor_m) > _FLOOR_MOVED_M:
            grid = self._begin(low, high, floor)
        self._put(grid, snapshot, obstacles)
        self._since_observed += 1
        if self._sent is None or self._since_observed >= self._observe_every:
            seen = seen_columns(snapshot.submaps, grid.frame, self._band, self._floor_m)
            grid.observe(seen.walls, unknown_hulls(seen.is_known, grid.frame, self._band))
            self._since_observed = 0
        if self._seen is not None:
            grid.put_hulls(SEEN_SURFACE, self._seen.hulls(snapshot, obstacles, self._band, self._floor_m))
        return self._changed(grid, snapshot.stamp_ns)

    def _put(self, grid: Occupancy, snapshot: MapSnapshot, obstacles: Sequence[Obstacle]) -> None:
        """Stamp the obstacles that are new or have changed, and take those out that are gone."""
        records = {tracked.id: tracked for tracked in snapshot.objects}
        for object_id in sorted(self._known.keys() - {obstacle.id for obstacle in obstacles}):
            grid.remove(object_id)
            del self._known[object_id]
        for obstacle in obstacles:
            tracked = records[obstacle.id]
            shape: object = tracked.box if tracked.shape is None else tracked.shape.inflated
            if obstacle.is_observed_only:
                shape = tracked  # any new point may reach out
            if self._known.get(obstacle.id) is not shape:
                grid.put(obstacle.id, obstacle.body)
                self._known[obstacle.id] = shape

    def _begin(self, low: NDArray[np.float64], high: NDArray[np.float64], floor_m: float) -> Occupancy:
        """Return a new, larger grid, or one for another height of the floor."""
        if self._grid is not None:
            low, high = np.minimum(low, self._grid.frame.origin_m), np.maximum(high, self._grid.frame.high_m)
        frame = frame_around(np.floor(low / _ROOM_M) * _ROOM_M, np.ceil(high / _ROOM_M) * _ROOM_M, self._cell_m)
        bottom, top = self._heights_m
        part = Part(low_m=floor_m + bottom, high_m=floor_m + top)
        self._grid = Occupancy(frame, [part])
        self._band = Band(low_m=part.low_m, high_m=part.high_m)
        self._floor_m, self._known, self._sent = floor_m, {}, None
        return self._grid

    def _changed(self, grid: Occupancy, stamp_ns: int) -> CostmapUpdate | None:
        states, sent = grid.states(), self._sent
        self._sent = states
        if sent is None:
            return CostmapUpdate(stamp_ns=stamp_ns, frame=grid.frame, row=0, column=0, states=states, is_whole=True)
        rows, columns = np.nonzero(states != sent)
        if len(rows) == 0:
            return None
        window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        return CostmapUpdate(
            stamp_ns=stamp_ns,
            frame=grid.frame,
            row=int(rows.min()),
            column=int(columns.min()),
            states=states[window],
            is_whole=False,
        )


def _holds(frame: GridFrame, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    return bool((low >= frame.origin_m - 1e-9).all() and (high <= frame.high_m + 1e-9).all())
