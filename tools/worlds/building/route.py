"""A walk through a building, storey by storey and back to the stairs; in rooms it looks at objects seen least."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from hickory_stream.geometry.arrays import freeze
from hickory_stream.worlds.clearance import CELL_M, Clearance, clearance_of
from hickory_stream.worlds.trajectory import STEP_S, NoWalk, Trajectory, WalkConfig, camera_poses, gaze
from tools.worlds.building.building import Building, Storey
from tools.worlds.building.plan import STOREY_M
from tools.worlds.routes import corners_of, way_between

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
    """Return a way of at least `length_m`, None for one round; None if a room cannot be reached."""
    # A round is every storey up and down. Odd walks visit storeys and rooms in reverse; every second begins elsewhere.
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
        so_far_m += float(np.linalg.norm(np.diff(lines[-1], axis=0), axis=1).sum())
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


_CUT = 0.6
_AHEAD_PITCH_RAD = -0.35
_BLEND_S = 0.25


def building_walk(
    house: Building, seconds: float | None, config: WalkConfig, walk_index: int, rng: np.random.Generator
) -> Trajectory | NoWalk:
    """Return a walk of `seconds`, None for one round (`route.route_through`)."""
    speed = config.speed_mps
    route = route_through(house, None if seconds is None else speed * (seconds + 2 * STEP_S), walk_index, rng)
    if route is None:
        return NoWalk(clearance_m=0.0)
    if route.clearance_m < _CUT * config.clearance_m:
        return NoWalk(clearance_m=route.clearance_m)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(route.line_m, axis=0), axis=1))])
    times_s = np.arange(0.0, (arc[-1] / speed if seconds is None else seconds) + 2 * STEP_S, STEP_S)
    on = np.minimum(speed * times_s, arc[-1])
    positions = np.stack([np.interp(on, arc, route.line_m[:, i]) for i in range(3)], axis=1)
    storeys = route.storeys[np.minimum(np.searchsorted(arc, on), len(arc) - 1)]
    yaw, pitch = _looks(house, positions[:, :2], storeys, config)
    poses = camera_poses(times_s, positions[:, :2], yaw, pitch, config)
    poses[:, 2, 3] += positions[:, 2]
    return Trajectory(times_s=times_s, world_from_camera=poses)


def _looks(
    house: Building, positions: NDArray[np.float64], storeys: NDArray[np.int64], config: WalkConfig
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    # Planned on each visit of a room for itself, and joined without a jerk.
    is_in_room = np.array([_is_in_room(house, *place) for place in zip(positions, storeys.tolist(), strict=True)])
    starts = np.concatenate([[0], np.flatnonzero(np.diff(is_in_room)) + 1, [len(storeys)]])
    yaws: list[NDArray[np.float64]] = []
    pitches: list[NDArray[np.float64]] = []
    for first, last in zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True):
        part = positions[first:last]
        before = float(yaws[-1][-1]) if yaws else None
        if is_in_room[first]:
            yaw, pitch = gaze(house.storeys[int(storeys[first])].world, part, STEP_S, config, first_yaw=before)
        else:
            yaw = _ahead(part, np.pi if before is None else before, config)
            pitch = np.full(len(part), _AHEAD_PITCH_RAD)
        yaws.append(yaw)
        pitches.append(pitch)
    yaw, pitch = (gaussian_filter1d(np.concatenate(v), _BLEND_S / STEP_S, mode="nearest") for v in (yaws, pitches))
    return yaw, pitch


def _is_in_room(house: Building, position: NDArray[np.float64], storey: int) -> bool:
    if storey == STAIRS:
        return False
    x, y = position
    return any(x0 < x < x1 and y0 < y < y1 for x0, y0, x1, y1 in house.storeys[storey].plan.rooms_m)


def _ahead(positions: NDArray[np.float64], yaw: float, config: WalkConfig) -> NDArray[np.float64]:
    if len(positions) < 2:
        return np.full(len(positions), yaw)
    most = np.radians(config.max_yaw_rate_dps) * STEP_S
    steps = np.gradient(positions, axis=0)
    angles = np.empty(len(positions))
    for i, heading in enumerate(np.arctan2(steps[:, 1], steps[:, 0])):
        yaw += float(np.clip(np.angle(np.exp(1j * (heading - yaw))), -most, most))
        angles[i] = yaw
    return angles
