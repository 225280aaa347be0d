"""The occupancy of a growing map as a stream: a whole grid first, then updates of the windows that changed.

An object is stamped again only if its layer 4 (or its box) has changed; walls and unknown space every few snapshots,
since the whole observed space has to be searched for them. In a live run the grid includes early obstacles.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import InputError
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.superquadric import Superquadrics
from hickory_stream.navigation.free_space import bodies_of, extent_of
from hickory_stream.navigation.observed import Band, seen_columns, unknown_hulls
from hickory_stream.navigation.occupancy import GridFrame, Occupancy, frame_around
from hickory_stream.navigation.robot import Part, Robot
from hickory_stream.navigation.stand_ins import SEEN_SURFACE, Obstacle, SeenSurface
from hickory_stream.records import MapSnapshot
from hickory_stream.storeys import newest_floor_of

_ROOM_M = 2.0
_FLOOR_MOVED_M = 0.02
_MOST_DRIVEN = 2000


class Stamped(Protocol):
    """A grid that obstacles are stamped into: of one body, or of all postures and headings of a robot."""

    @property
    def frame(self) -> GridFrame:
        """The position of the cells in the world."""

    def put(self, object_id: int, inflated: Superquadrics) -> None:
        """Add an object, or replace its former shape."""

    def put_hulls(self, object_id: int, hulls: NDArray[np.float64]) -> None:
        """Add an object that is a union of convex hulls, or replace its former shape."""

    def remove(self, object_id: int) -> None:
        """Remove an object."""

    def observe(self, walls: NDArray[np.float64], unknown: NDArray[np.float64]) -> None:
        """Set the convex hulls of structure and of unobserved space."""


Grid = TypeVar("Grid", bound=Stamped)


class Followed(Generic[Grid]):
    """Keeps a grid up to date with snapshots; `make` returns a new one for given cells and a height of the floor.

    `heights_m` are those of the body above the floor, `num_layers` are the grids that `make` makes of one frame, and
    `seen` is the surface seen in a live run, to which the caller adds.
    """

    def __init__(
        self,
        make: Callable[[GridFrame, float], Grid],
        heights_m: tuple[float, float],
        *,
        cell_m: float,
        reach_m: float = 0.0,
        num_layers: int = 1,
        observe_every: int = 5,
        seen: SeenSurface | None = None,
    ) -> None:
        self._make = make
        self._heights_m = heights_m
        self._cell_m = cell_m
        self._reach_m = reach_m
        self._driven: list[NDArray[np.float64]] = []
        self._num_layers = num_layers
        self._observe_every = observe_every
        self._seen = seen
        self._grid: Grid | None = None
        self._band = Band(low_m=0.0, high_m=0.0)
        self._floor_m = 0.0
        self._known: dict[int, object] = {}
        self._since_observed = 0

    @property
    def grid(self) -> Grid | None:
        """The grid of the last snapshot, None before the first."""
        return self._grid

    def update(self, snapshot: MapSnapshot) -> Grid | None:
        """Return the grid of a snapshot, a new one if it had to grow; None while nothing has been observed."""
        obstacles = bodies_of(snapshot, early=self._seen is not None)
        try:
            low, high = extent_of(snapshot, obstacles)
        except InputError:
            return None
        floor = newest_floor_of(snapshot)
        grid = self._grid
        if grid is None or not _holds(grid.frame, low, high) or abs(floor - self._floor_m) > _FLOOR_MOVED_M:
            grid = self._begin(low, high, floor)
        self._put(grid, snapshot, obstacles)
        self._since_observed += 1
        if self._since_observed >= self._observe_every:
            seen = seen_columns(snapshot.submaps, grid.frame, self._band, self._floor_m)
            is_known = seen.is_known | self._is_driven(grid.frame)
            grid.observe(seen.walls, unknown_hulls(is_known, grid.frame, self._band))
            self._since_observed = 0
        if self._seen is not None:
            grid.put_hulls(SEEN_SURFACE, self._seen.hulls(snapshot, obstacles, self._band, self._floor_m))
        return grid

    def drove(self, place: NDArray[np.float64]) -> None:
        """Note that the body is at (2,): the space that it occupies there is not unknown, even if no camera saw it."""
        if not self._driven or float(np.linalg.norm(self._driven[-1] - place)) > self._cell_m:
            self._driven = [*self._driven[-_MOST_DRIVEN:], place]

    def _is_driven(self, frame: GridFrame) -> NDArray[np.bool_]:
        # Cells (rows, columns) that the body has touched, wherever in its cell its centre was.
        is_driven = np.zeros(frame.shape, bool)
        reach = int(np.ceil(self._reach_m / frame.cell_m)) + 2
        for row, column in frame.cells_of(np.array(self._driven).reshape(-1, 2)).tolist():
            first = max(row - reach, 0), max(column - reach, 0)
            rows, columns = np.ogrid[first[0] : row + reach + 1, first[1] : column + reach + 1]
            window = is_driven[first[0] : row + reach + 1, first[1] : column + reach + 1]
            is_near = (rows - row) ** 2 + (columns - column) ** 2 <= reach**2
            window |= is_near[: window.shape[0], : window.shape[1]]
        return is_driven

    def _begin(self, low: NDArray[np.float64], high: NDArray[np.float64], floor_m: float) -> Grid:
        if self._grid is not None:
            low, high = np.minimum(low, self._grid.frame.origin_m), np.maximum(high, self._grid.frame.high_m)
        low, high = np.floor(low / _ROOM_M) * _ROOM_M, np.ceil(high / _ROOM_M) * _ROOM_M
        self._grid = self._make(frame_around(low, high, self._cell_m, num_layers=self._num_layers), floor_m)
        bottom, top = self._heights_m
        self._band = Band(low_m=floor_m + bottom, high_m=floor_m + top)
        self._floor_m, self._known = floor_m, {}
        self._since_observed = self._observe_every
        return self._grid

    def _put(self, grid: Grid, snapshot: MapSnapshot, obstacles: Sequence[Obstacle]) -> None:
        records = {tracked.id: tracked for tracked in snapshot.objects}
        for object_id in sorted(self._known.keys() - {obstacle.id for obstacle in obstacles}):
            grid.remove(object_id)
            del self._known[object_id]
        for obstacle in obstacles:
            tracked = records[obstacle.id]
            shape: object = tracked.box if tracked.shape is None else tracked.shape.inflated
            if obstacle.is_observed_only:
                shape = tracked  # Any new point may extend the box; its points are made whenever they are read.
            if self._known.get(obstacle.id) is not shape:
                grid.put(obstacle.id, obstacle.body)
                self._known[obstacle.id] = shape


def _holds(frame: GridFrame, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    return bool((low >= frame.origin_m - 1e-9).all() and (high <= frame.high_m + 1e-9).all())


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

    def __init__(self, robot: Robot, *, cell_m: float, observe_every: int = 5, seen: SeenSurface | None = None) -> None:
        bottom, top = robot.heights_m

        def made(frame: GridFrame, floor_m: float) -> Occupancy:
            return Occupancy(frame, [Part(low_m=floor_m + bottom, high_m=floor_m + top)])

        self._followed = Followed(made, (bottom, top), cell_m=cell_m, observe_every=observe_every, seen=seen)
        self._sent: tuple[Occupancy, NDArray[np.int8]] | None = None

    def begin_again(self) -> None:
        """Make the next update a whole grid, for a subscriber that has missed an update."""
        self._sent = None

    def update(self, snapshot: MapSnapshot) -> CostmapUpdate | None:
        """Return what changed with a snapshot, None for nothing."""
        grid = self._followed.update(snapshot)
        if grid is None:
            return None
        states = grid.states()
        sent = self._sent[1] if self._sent is not None and self._sent[0] is grid else None
        self._sent = (grid, states)
        if sent is None:
            return CostmapUpdate(
                stamp_ns=snapshot.stamp_ns, frame=grid.frame, row=0, column=0, states=states, is_whole=True
            )
        rows, columns = np.nonzero(states != sent)
        if len(rows) == 0:
            return None
        window = np.s_[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1]
        return CostmapUpdate(
            stamp_ns=snapshot.stamp_ns,
            frame=grid.frame,
            row=int(rows.min()),
            column=int(columns.min()),
            states=states[window],
            is_whole=False,
        )
