"""A long walk through a building, and where one looks: in rooms at what was seen least, else where one goes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hickory_stream.worlds.trajectory import STEP_S, NoWalk, Trajectory, camera_poses, gaze
from tools.worlds.building.route import STAIRS, route_through

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.trajectory import WalkConfig
    from tools.worlds.building.building import Building

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
