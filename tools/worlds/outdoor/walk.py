"""A walk along a street: down the pavement, over the road where the kerb is lowered, back over the lawn."""

from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from hickory_stream.worlds.clearance import Clearance, clearance_of
from hickory_stream.worlds.depth_camera import D455
from hickory_stream.worlds.recording_config import RecordingConfig
from hickory_stream.worlds.trajectory import STEP_S, NoWalk, Trajectory, WalkConfig, camera_poses, gaze
from tools.worlds.outdoor.street import Street
from tools.worlds.routes import smoothed, way_between

Config = TypeVar("Config", bound=RecordingConfig)

# The distance over which the camera's height follows a kerb.
_STEP_M = 0.25
_CUT = 0.5


def stroll(street: Street, seconds: float | None, config: WalkConfig, walk_index: int) -> Trajectory | NoWalk:
    """Return a closed walk, the camera at eye height above the ground; `seconds` None is one round."""
    clearance = clearance_of(street.world)
    route = _route(street, clearance)
    if route is None:
        return NoWalk(clearance_m=0.0)
    line = smoothed(route[::-1] if walk_index % 2 else route)
    line = np.roll(line[:-1], -(walk_index // 2) * (len(line) // 4), axis=0)
    line = np.vstack([line, line[:1]])
    clearance_m = float(clearance.at(line).min())
    if clearance_m < _CUT * config.clearance_m:
        return NoWalk(clearance_m=clearance_m)
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    lasts = arc[-1] / config.speed_mps if seconds is None else seconds
    times_s = np.arange(0.0, lasts + 2 * STEP_S, STEP_S)
    on = np.mod(config.speed_mps * times_s, arc[-1])
    positions = np.stack([np.interp(on, arc, line[:, i]) for i in range(2)], axis=1)
    steps = _STEP_M / (config.speed_mps * STEP_S)
    ground_m = gaussian_filter1d(street.terrain.height_m(positions), steps, mode="nearest")
    yaw, pitch = gaze(street.world, positions, STEP_S, config)
    poses = camera_poses(times_s, positions, yaw, pitch, config)
    poses[:, 2, 3] += ground_m
    return Trajectory(times_s=times_s, world_from_camera=poses)


def _route(street: Street, clearance: Clearance) -> NDArray[np.float64] | None:
    far, near = street.terrain.kerbs_m
    low, high = street.terrain.crossings_m
    pavement, lawn = (near + street.terrain.front_m) / 2, far - 3.2
    # Between the two rows of trees and past both sides of the objects on the lawn.
    wanted = [
        (low + 0.9, pavement), (0.0, pavement), (high - 0.6, pavement), (high, (far + near) / 2), (high, far - 2.0),
        (2.6, lawn - 0.5), (0.0, lawn + 0.5), (-2.6, lawn - 0.5), (low, far - 2.0), (low, (far + near) / 2),
    ]  # fmt: skip
    stops = [_clear_place(clearance, np.array(at)) for at in wanted]
    pieces = [way_between(clearance, a, b) for a, b in zip(stops, [*stops[1:], stops[0]], strict=True)]
    if any(piece is None for piece in pieces):
        return None
    return np.concatenate([piece[:-1] for piece in pieces if piece is not None])


def _clear_place(clearance: Clearance, wanted: NDArray[np.float64]) -> NDArray[np.float64]:
    spread = np.arange(-0.9, 0.91, 0.06)
    grid = wanted + np.stack(np.meshgrid(spread, spread, indexing="ij"), axis=-1).reshape(-1, 2)
    value = np.minimum(clearance.at(grid), 0.6) - 0.25 * np.linalg.norm(grid - wanted, axis=1)
    return np.asarray(grid[int(np.argmax(value))])


def outdoors(config: Config) -> Config:
    """Return a config with the camera and the walk of a street: a D455 at 0.7 m/s, which looks a little downwards."""
    walk = replace(config.walk, speed_mps=0.7, pitch_deg=(-28.0, -10.0))
    return replace(config, depth=D455, walk=walk)
