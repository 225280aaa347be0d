"""A person's walk in a room: a closed loop around its centre along the line of largest clearance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import from_rotation_translation, interpolate
from hickory_stream.worlds.clearance import clearance_of
from hickory_stream.worlds.gaze import gaze

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.scene import World
    from hickory_stream.worlds.walk_config import WalkConfig

STEP_S = 1 / 60


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Trajectory:
    """Densely sampled camera poses: `times_s` (N,) from 0, `world_from_camera` (N, 4, 4)."""

    times_s: NDArray[np.float64]
    world_from_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze(self, "times_s", np.float64, (None,))
        freeze(self, "world_from_camera", np.float64, (len(self.times_s), 4, 4))

    def pose_at(self, time_s: float) -> NDArray[np.float64]:
        """Return `world_from_camera` at a time within the walk."""
        i = int(np.clip(np.searchsorted(self.times_s, time_s, side="right") - 1, 0, len(self.times_s) - 2))
        fraction = (time_s - self.times_s[i]) / (self.times_s[i + 1] - self.times_s[i])
        return interpolate(self.world_from_camera[i], self.world_from_camera[i + 1], float(fraction))


@dataclass(frozen=True, kw_only=True, slots=True)
class NoWalk:
    """There is no loop with enough clearance."""

    clearance_m: float


def walk_round(world: World, seconds: float, config: WalkConfig, rng: np.random.Generator) -> Trajectory | NoWalk:
    """Return a walk of `seconds` around the centre of the world, with random start and direction."""
    loop, clearance_m = _clear_loop(world)
    if clearance_m < config.clearance_m:
        return NoWalk(clearance_m=clearance_m)
    if rng.random() < 0.5:
        loop = loop[::-1]
    loop = np.roll(loop, int(rng.integers(len(loop))), axis=0)
    times_s = np.arange(0.0, seconds + 2 * STEP_S, STEP_S)
    positions = _along_loop(loop, config.speed_mps * times_s)
    yaw, pitch = gaze(world, positions, STEP_S, config)
    return Trajectory(times_s=times_s, world_from_camera=camera_poses(times_s, positions, yaw, pitch, config))


def _clear_loop(world: World) -> tuple[NDArray[np.float64], float]:
    """Return (360, 2) points around the centre on the ridge of the clearance map, and the least clearance on it."""
    clearance = clearance_of(world)
    radii = np.arange(0.6, 2.6, 0.03)
    angles = 2 * np.pi * np.arange(360) / 360
    outward = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    points = np.asarray(world.middle_m) + radii[None, :, None] * outward[:, None]
    value = clearance.at(points) - 0.15 * np.abs(radii - 1.4)[None]
    ridge = radii[np.argmax(value, axis=1)]
    smooth = gaussian_filter1d(ridge, 14.0, mode="wrap")
    loop = np.asarray(world.middle_m) + smooth[:, None] * outward
    return loop, float(clearance.at(loop).min())


def _along_loop(loop: NDArray[np.float64], distances_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the (N, 2) points at given distances along a closed polyline."""
    closed = np.vstack([loop, loop[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    on = np.mod(distances_m, arc[-1])
    return np.stack([np.interp(on, arc, closed[:, i]) for i in range(2)], axis=1)


def camera_poses(
    times_s: NDArray[np.float64],
    positions: NDArray[np.float64],
    yaw: NDArray[np.float64],
    pitch: NDArray[np.float64],
    config: WalkConfig,
) -> NDArray[np.float64]:
    """Return (N, 4, 4) `world_from_camera` with the gait's bobbing and a little roll."""
    gait = 2 * np.pi * config.step_hz * times_s
    heights = config.eye_height_m + config.bob_m * np.sin(gait)
    rolls = np.radians(0.6) * np.sin(gait / 2)
    poses = np.empty((len(times_s), 4, 4))
    for i in range(len(times_s)):
        rotation = camera_rotation(float(yaw[i]), float(pitch[i]), float(rolls[i]))
        poses[i] = from_rotation_translation(rotation, np.array([*positions[i], heights[i]]))
    return poses


def camera_rotation(yaw_rad: float, pitch_rad: float, roll_rad: float) -> NDArray[np.float64]:
    """Return (3, 3) world from camera (x right, y down, z forward): yaw about the vertical, pitch upwards, roll."""
    cy, sy, cp, sp = np.cos(yaw_rad), np.sin(yaw_rad), np.cos(pitch_rad), np.sin(pitch_rad)
    forward = np.array([cy * cp, sy * cp, sp])
    right = np.array([sy, -cy, 0.0])
    down = np.cross(forward, right)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([c * right + s * down, c * down - s * right, forward], axis=1)
