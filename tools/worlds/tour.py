"""A walk through every room of an apartment: around each of them, through the doors, and back to the start."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.worlds.clearance import CELL_M, clearance_of
from hickory_stream.worlds.gaze import gaze
from hickory_stream.worlds.trajectory import STEP_S, NoWalk, Trajectory, camera_poses
from tools.worlds.routes import smoothed, way_between

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.clearance import Clearance
    from hickory_stream.worlds.scene import World
    from hickory_stream.worlds.walk_config import WalkConfig

_MIN_SECONDS = 60.0
# The rooms are a grid of two by two: in this order, consecutive rooms are neighbours.
_ROUND = (0, 1, 3, 2)


def tour(world: World, seconds: float | None, config: WalkConfig, walk_index: int) -> Trajectory | NoWalk:
    """Return a walk through all rooms; `walk_index` selects its start and direction.

    `seconds` None is the duration of the tour, and at least a minute; a longer walk is repeated.
    """
    clearance = clearance_of(world)
    route = _route(world, clearance, walk_index)
    if route is None:
        return NoWalk(clearance_m=0.0)
    line = smoothed(route)
    clearance_m = float(clearance.at(line).min())
    if clearance_m < 0.6 * config.clearance_m:
        return NoWalk(clearance_m=clearance_m)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    speed = config.speed_mps
    lasts = max(arc[-1] / speed, _MIN_SECONDS) if seconds is None else seconds
    times_s = np.arange(0.0, lasts + 2 * STEP_S, STEP_S)
    # Back and forth if the time is longer than the tour.
    on = arc[-1] - np.abs(np.mod(speed * times_s, 2 * arc[-1]) - arc[-1])
    positions = np.stack([np.interp(on, arc, line[:, i]) for i in range(2)], axis=1)
    yaw, pitch = gaze(world, positions, STEP_S, config)
    return Trajectory(times_s=times_s, world_from_camera=camera_poses(times_s, positions, yaw, pitch, config))


def _route(world: World, clearance: Clearance, walk_index: int) -> NDArray[np.float64] | None:
    """Return (N, 2) points through the corners of all rooms, None if two of them are not connected."""
    order: tuple[int, ...] = _ROUND if walk_index % 2 == 0 else _ROUND[::-1]
    start = (walk_index // 2 + walk_index) % len(order)
    order = order[start:] + order[:start]
    stops: list[NDArray[np.float64]] = []
    for room in order:
        corners = corners_of(world.rooms_m[room], clearance)
        if walk_index % 2:
            corners = corners[::-1]
        if stops and len(corners):
            nearest = int(np.argmin(np.linalg.norm(np.array(corners) - stops[-1], axis=1)))
            corners = corners[nearest:] + corners[:nearest]
        stops += corners
    if not stops:
        return None
    pieces = [way_between(clearance, a, b) for a, b in zip(stops, [*stops[1:], stops[0]], strict=True)]
    if any(piece is None for piece in pieces):
        return None
    return np.concatenate([piece[:-1] for piece in pieces if piece is not None])


def corners_of(room: tuple[float, float, float, float], clearance: Clearance) -> list[NDArray[np.float64]]:
    """Return a free position in each quarter of a room, counter-clockwise; quarters full of furniture have none."""
    x0, y0, x1, y1 = room
    places = []
    for fx, fy in ((0.3, 0.3), (0.7, 0.3), (0.7, 0.7), (0.3, 0.7)):
        wanted = np.array([x0 + fx * (x1 - x0), y0 + fy * (y1 - y0)])
        spread = np.arange(-0.8, 0.81, CELL_M)
        grid = wanted + np.stack(np.meshgrid(spread, spread, indexing="ij"), axis=-1).reshape(-1, 2)
        clear = clearance.at(grid)
        value = np.minimum(clear, 0.6) - 0.25 * np.linalg.norm(grid - wanted, axis=1)
        best = int(np.argmax(value))
        if clear[best] >= 0.32:
            places.append(grid[best])
    return places
