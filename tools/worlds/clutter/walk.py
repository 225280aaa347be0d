"""A walk through a random room, between random free places, that looks at the objects."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from hickory_stream.worlds.clearance import CELL_M, Clearance, clearance_among
from hickory_stream.worlds.scene import World, part_boxes
from hickory_stream.worlds.trajectory import STEP_S, NoWalk, Trajectory, WalkConfig, camera_poses, gaze
from tools.worlds.clutter.room import ClutterRoom
from tools.worlds.routes import smoothed, way_between

_STOPS = 6
# The minimum area of a connected piece of free floor.
_LEAST_FLOOR_M2, _LEAST_WAY_M = 0.6, 2.0
# Smoothing a route cuts corners, by at most this share of the clearance.
_CUT = 0.5


def wander(room: ClutterRoom, seconds: float, config: WalkConfig, rng: np.random.Generator) -> Trajectory | NoWalk:
    """Return a closed walk past a few random places, repeated if `seconds` is longer than it."""
    boxes = [box for item in room.world.objects for box in part_boxes(item.model, item.world_from_object)]
    boxes += [b for model in room.world.structure if model.kind == "column" for b in part_boxes(model, np.eye(4))]
    clearance = clearance_among(boxes, room.plan.bounds_m, room.plan.outline_m)
    return wander_through(room.world, clearance, seconds, config, rng)


def wander_through(
    world: World, clearance: Clearance, seconds: float, config: WalkConfig, rng: np.random.Generator
) -> Trajectory | NoWalk:
    """Return a closed walk past a few random places of a world's largest piece of free floor."""
    route = _route(clearance, config.clearance_m, rng)
    if route is None:
        return NoWalk(clearance_m=config.clearance_m)
    line = smoothed(route)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    clearance_m = float(clearance.at(line).min())
    if arc[-1] < _LEAST_WAY_M or clearance_m < _CUT * config.clearance_m:
        return NoWalk(clearance_m=clearance_m)
    times_s = np.arange(0.0, seconds + 2 * STEP_S, STEP_S)
    on = np.mod(config.speed_mps * times_s, arc[-1])
    positions = np.stack([np.interp(on, arc, line[:, i]) for i in range(2)], axis=1)
    yaw, pitch = gaze(world, positions, STEP_S, config)
    return Trajectory(times_s=times_s, world_from_camera=camera_poses(times_s, positions, yaw, pitch, config))


def _route(clearance: Clearance, clearance_m: float, rng: np.random.Generator) -> NDArray[np.float64] | None:
    pieces, count = label(clearance.distance_m >= clearance_m)
    if count == 0:
        return None
    largest = 1 + int(np.argmax([(pieces == i).sum() for i in range(1, count + 1)]))
    cells = np.argwhere(pieces == largest)
    if len(cells) * CELL_M**2 < _LEAST_FLOOR_M2:
        return None
    stops = [clearance.place((int(i), int(j))) for i, j in cells[_apart(cells, rng)]]
    ways = [way_between(clearance, a, b) for a, b in zip(stops, [*stops[1:], stops[0]], strict=True)]
    if any(way is None for way in ways):
        return None
    return np.concatenate([way[:-1] for way in ways if way is not None])


def _apart(cells: NDArray[np.intp], rng: np.random.Generator) -> list[int]:
    chosen = [int(rng.integers(len(cells)))]
    while len(chosen) < _STOPS:
        some = rng.integers(len(cells), size=8)
        away = np.linalg.norm(cells[some][:, None] - cells[chosen][None], axis=2).min(axis=1)
        chosen.append(int(some[np.argmax(away)]))
    return chosen
