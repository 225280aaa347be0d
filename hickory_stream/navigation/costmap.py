"""The occupancy of a map that grows, as a stream: a whole grid first, then the windows that changed.

An object is stamped again only when its layer 4 (or, without one, its box) is another one; walls and unknown space
every few snapshots, since the whole observed space is looked through for them. The grid grows in steps of metres; when
it does, the next message is a whole one again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import InputError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.navigation.free_space import extent_of, floor_of, layer_four_of, obstacles_of
from hickory_stream.navigation.observed import Band, seen_columns, unknown_hulls
from hickory_stream.navigation.occupancy import GridFrame, Occupancy, frame_around
from hickory_stream.navigation.robot import Part

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.navigation.robot import Robot
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
    """Follows the snapshots of a run; obstacles at the heights of a robot, in any posture, without its footprint."""

    def __init__(self, robot: Robot, *, cell_m: float, observe_every: int = 5) -> None:
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
        try:
            low, high = extent_of(snapshot)
        except InputError:
            return None  # nothing was seen yet
        floor = floor_of(snapshot)
        grid = self._grid
        if grid is None or not _holds(grid.frame, low, high) or abs(floor - self._floor_m) > _FLOOR_MOVED_M:
            grid = self._begin(low, high, floor)
        obstacles = {tracked.id: tracked for tracked in obstacles_of(snapshot)}
        for object_id in sorted(self._known.keys() - obstacles.keys()):
            grid.remove(object_id)
            del self._known[object_id]
        for object_id, tracked in obstacles.items():
            shape = tracked.box if tracked.shape is None else tracked.shape.inflated
            if self._known.get(object_id) is not shape:
                grid.put(object_id, layer_four_of(tracked))
                self._known[object_id] = shape
        self._since_observed += 1
        if self._sent is None or self._since_observed >= self._observe_every:
            seen = seen_columns(snapshot.submaps, grid.frame, self._band, self._floor_m)
            grid.observe(seen.walls, unknown_hulls(seen.is_known, grid.frame, self._band))
            self._since_observed = 0
        return self._changed(grid, snapshot.stamp_ns)

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
