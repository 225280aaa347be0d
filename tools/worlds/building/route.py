"""The way through a building: storey by storey, in each through its rooms and back to the stairs."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hickory_stream.geometry.arrays import freeze
from hickory_stream.worlds.clearance import CELL_M, Clearance, clearance_of
from tools.worlds.building.stairwell import STOREY_M
from tools.worlds.routes import corners_of, way_between

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from tools.worlds.building.building import Building, Storey

STAIRS = -1
"""Stands for the stairs where a storey's number is asked for."""
# Of the rooms of a storey that one comes back to, so many are visited again.
_AGAIN_SHARE = 0.4
_FROM_DOOR_M = 0.35
# A way between two places is sought this far beyond them along the corridor: the width of a room, nearly.
_BEYOND_M = 2.5
_SMOOTH_CELLS = 8.0


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Route:
    """A way on the floor: `line_m` (N, 3), and of each point the storey, or `STAIRS`."""

    line_m: NDArray[np.float64]
    storeys: NDArray[np.int64]
    #: The least distance to an obstacle on the storeys.
    clearance_m: float

    def __post_init__(self) -> None:
        freeze(self, "line_m", np.float64, (None, 3))
        freeze(self, "storeys", np.int64, (len(self.line_m),))


def route_through(house: Building, length_m: float | None, walk_index: int, rng: np.random.Generator) -> Route | None:
    """Return a way of at least `length_m`, None for one round; None if a room cannot be reached.

    A round is every storey up and down. Odd walks visit storeys and rooms in reverse; every second begins elsewhere.
    """
    clearances = [clearance_of(storey.world) for storey in house.storeys]
    lines: list[NDArray[np.float64]] = []
    storeys: list[NDArray[np.int64]] = []
    so_far_m, least_m, at = 0.0, np.inf, None
    for storey, rooms in _visits(house, walk_index, rng, is_endless=length_m is not None):
        if at is not None and at != storey:
            lines.append(_stairs(house, at, storey))
            storeys.append(np.full(len(lines[-1]), STAIRS))
        at = storey
        flat = _through_rooms(house.storeys[storey], clearances[storey], rooms)
        if flat is None:
            return None
        least_m = min(least_m, float(clearances[storey].at(flat).min()))
        lines.append(np.column_stack([flat, np.full(len(flat), house.storeys[storey].floor_m)]))
        storeys.append(np.full(len(flat), storey))
        so_far_m += _length_m(lines[-1])
        if length_m is not None and so_far_m > length_m:
            break
    return Route(line_m=np.concatenate(lines), storeys=np.concatenate(storeys), clearance_m=least_m)


def _visits(
    house: Building, walk_index: int, rng: np.random.Generator, *, is_endless: bool
) -> Iterator[tuple[int, list[int]]]:
    # Yields storeys with the rooms to visit there: all rooms the first time, a drawn share of them later.
    known: set[int] = set()
    sweep = _sweep(len(house.storeys), walk_index)
    while True:
        for storey in sweep:
            rooms = _in_turn(house.storeys[storey])
            if storey in known:
                again = max(1, round(_AGAIN_SHARE * len(rooms)))
                chosen = set(rng.choice(rooms, size=again, replace=False).tolist())
                rooms = [room for room in rooms if room in chosen]
            known.add(storey)
            yield storey, rooms[::-1] if walk_index % 2 else rooms
        if not is_endless:
            return


def _sweep(count: int, walk_index: int) -> list[int]:
    # Storeys, each a neighbour of the one before: from one of them to the top, to the ground, and back.
    if count == 1:
        return [0, 0]
    start = (walk_index // 2) % count
    if walk_index % 2:  # down first
        return [count - 1 - i for i in _up_and_down(count, count - 1 - start)]
    return _up_and_down(count, start)


def _up_and_down(count: int, start: int) -> list[int]:
    return [*range(start, count), *range(count - 2, -1, -1), *range(1, start + 1)]


def _in_turn(storey: Storey) -> list[int]:
    # Rooms from the stairs along one side of the corridor, and back along the other.
    middles = [(room[0] + room[2]) / 2 for room in storey.plan.rooms_m]
    away, back = ([i for i, side in enumerate(storey.plan.sides) if side == which] for which in (0, 1))
    return sorted(away, key=lambda i: -middles[i]) + sorted(back, key=lambda i: middles[i])


def _through_rooms(storey: Storey, clearance: Clearance, rooms: Sequence[int]) -> NDArray[np.float64] | None:
    door = _before_stairs(storey)
    stops = [door]
    for room in rooms:
        corners = corners_of(storey.world.rooms_m[room], clearance)
        if corners:
            nearest = int(np.argmin(np.linalg.norm(np.array(corners) - stops[-1], axis=1)))
            stops += corners[nearest:] + corners[:nearest]
    pieces = [_way(clearance, a, b) for a, b in pairwise([*stops, door])]
    if any(piece is None for piece in pieces):
        return None
    way = np.concatenate([piece[:-1] for piece in pieces if piece is not None])
    return np.asarray(gaussian_filter1d(way, _SMOOTH_CELLS, axis=0, mode="nearest"))


def _before_stairs(storey: Storey) -> NDArray[np.float64]:
    outline = storey.plan.outline
    return np.array([outline.length_m - _FROM_DOOR_M, outline.width_m / 2])


def _way(clearance: Clearance, a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64] | None:
    # A search near the two places first takes a tenth of the time.
    ends = np.array([min(a[0], b[0]) - _BEYOND_M, max(a[0], b[0]) + _BEYOND_M])
    first, last = np.clip(np.round((ends - clearance.origin_m[0]) / CELL_M), 0, len(clearance.distance_m)).astype(int)
    near = Clearance(
        distance_m=clearance.distance_m[first:last], origin_m=clearance.origin_m + np.array([first * CELL_M, 0.0])
    )
    way = way_between(near, a, b)
    return way_between(clearance, a, b) if way is None else way


def _stairs(house: Building, a: int, b: int) -> NDArray[np.float64]:
    door = np.array([*_before_stairs(house.storeys[a]), 0.0])
    up = np.vstack([door, house.stairwell.way_up_m(), (*door[:2], STOREY_M)])
    corners = (up if b > a else up[::-1]) + (0.0, 0.0, min(a, b) * STOREY_M)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1))])
    on = np.arange(0.0, arc[-1], CELL_M)
    line = np.stack([np.interp(on, arc, corners[:, i]) for i in range(3)], axis=1)
    return np.asarray(gaussian_filter1d(line, _SMOOTH_CELLS / 2, axis=0, mode="nearest"))


def _length_m(line: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
