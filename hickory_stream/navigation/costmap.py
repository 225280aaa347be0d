"""The occupancy of a growing map as a stream: a whole grid first, then updates of the windows that changed.

When the grid grows, the next message is a whole one again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.geometry.arrays import freeze
from hickory_stream.navigation.followed import Followed
from hickory_stream.navigation.occupancy import GridFrame, Occupancy
from hickory_stream.navigation.robot import Part

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.navigation.robot import Robot
    from hickory_stream.navigation.stand_ins import SeenSurface
    from hickory_stream.records import MapSnapshot


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

    `seen`: in a live run, the observed surface, so that objects are obstacles before they are confirmed; the caller
    adds to it.
    """

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
