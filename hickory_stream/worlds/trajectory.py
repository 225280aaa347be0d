"""A person's walk in a room, along the line of largest clearance, and where the camera looks."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from hickory_stream.geometry.arrays import freeze_all
from hickory_stream.geometry.rigid import from_rotation_translation, interpolate
from hickory_stream.worlds.clearance import clearance_of
from hickory_stream.worlds.scene import World

_DECISION_S = 1.2
_LOOKAHEAD = 3


def gaze(
    world: World, positions: NDArray[np.float64], step_s: float, config: "WalkConfig"
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return smooth (N,) yaw and pitch of the optical axis, at first towards the middle of the room.

    The gaze turns to objects seen least, and to their unseen sides, at the angular rate of a head.
    """
    steps = round(_DECISION_S / step_s)
    attention = _Attention(world)
    yaw = _heading(attention.middle_of_room(positions[0]) - positions[0])
    knots = [yaw]
    pitches = [attention.pitch(positions[0], yaw, config)]
    turn = np.radians(config.max_yaw_rate_dps) * _DECISION_S
    stops = positions[steps::steps]
    for i, position in enumerate(stops):
        yaw += turn * attention.best_turn(stops[i : i + _LOOKAHEAD], yaw, turn)
        knots.append(yaw)
        pitches.append(attention.pitch(position, yaw, config))
        attention.look(position, yaw)
    at = np.arange(len(positions)) / steps
    sigma = 0.45 / step_s
    # Linear between the decisions and then smoothed, so that the angular rate stays within its limit.
    smooth_yaw, smooth_pitch = (
        gaussian_filter1d(np.interp(at, np.arange(len(values)), values), sigma, mode="nearest")
        for values in (knots, pitches)
    )
    return smooth_yaw, smooth_pitch


def _heading(direction: NDArray[np.float64]) -> float:
    return float(np.arctan2(direction[1], direction[0]))


class _Attention:
    _TURNS = (-1.0, -0.5, 0.0, 0.5, 1.0)
    _SIDES = 8

    def __init__(self, world: World) -> None:
        centers, sizes = [], []
        for item in world.objects:
            lower, upper = item.model.bounds_m()
            centers.append((item.world_from_object @ [*(lower + upper) / 2, 1.0])[:3])
            sizes.append(float(np.linalg.norm(upper - lower)))
        self._centers = np.array(centers)
        # Beyond this distance a look gains less, since small objects must be seen from near.
        self._reach_m = np.clip(1.2 + np.array(sizes), 1.5, 2.6)
        # Objects that stand together share their weight: a laid table must not outweigh a single lamp.
        apart = np.linalg.norm(self._centers[:, None] - self._centers[None], axis=2)
        self._weights = 1.0 / (apart < 0.7).sum(axis=1)
        self._looks = np.zeros((len(centers), self._SIDES))
        self._rooms = np.array(world.rooms_m)
        self._middles = (
            np.array([world.middle_m]) if len(world.rooms_m) == 1 else (self._rooms[:, :2] + self._rooms[:, 2:]) / 2
        )
        self._room_of = np.array([self._room(center[:2]) for center in self._centers])

    def middle_of_room(self, position: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(self._middles[self._room(position)])

    def _room(self, position: NDArray[np.float64]) -> int:
        outside = np.maximum(0.0, np.maximum(self._rooms[:, :2] - position, position - self._rooms[:, 2:]))
        return int(np.argmin((outside**2).sum(axis=1)))

    def best_turn(self, stops: NDArray[np.float64], yaw: float, turn_rad: float) -> float:
        # The turn in -1..1 that starts the best sequence of looks from the next few stops.
        return self._search(stops, yaw, turn_rad)[1]

    def _search(self, stops: NDArray[np.float64], yaw: float, turn_rad: float) -> tuple[float, float]:
        if len(stops) == 0:
            return 0.0, 0.0
        options = []
        for turn in self._TURNS:
            looked = yaw + turn * turn_rad
            later, _ = self._search(stops[1:], looked, turn_rad)
            options.append((float(self._gains(stops[0], looked).sum()) + later - 0.05 * abs(turn), turn))
        return max(options, key=lambda option: option[0])

    def _view(self, position: NDArray[np.float64], yaw: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        # How well each object is seen (N,), 0 if it is not visible, and from which side (N,).
        offset = self._centers[:, :2] - position
        distance = np.linalg.norm(offset, axis=1)
        bearing = np.arctan2(offset[:, 1], offset[:, 0])
        off_axis = np.abs(np.angle(np.exp(1j * (bearing - yaw))))
        quality = np.minimum(1.0, (self._reach_m / np.maximum(distance, 1e-3)) ** 2)
        quality[(off_axis > np.radians(34)) | (distance < 0.8) | (self._room_of != self._room(position))] = 0.0
        side = np.floor(np.mod(bearing, 2 * np.pi) / (2 * np.pi) * self._SIDES).astype(np.int64) % self._SIDES
        return quality, side

    def _gains(self, position: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
        quality, side = self._view(position, yaw)
        novelty = 1.0 / (1.0 + 2.0 * self._looks[np.arange(len(side)), side] + self._looks.sum(axis=1))
        return quality * novelty * self._weights

    def look(self, position: NDArray[np.float64], yaw: float) -> None:
        quality, side = self._view(position, yaw)
        self._looks[np.arange(len(side)), side] += quality

    def pitch(self, position: NDArray[np.float64], yaw: float, config: "WalkConfig") -> float:
        weight = self._gains(position, yaw) + 1e-3
        distance = np.linalg.norm(self._centers[:, :2] - position, axis=1)
        angles = np.arctan2(self._centers[:, 2] - config.eye_height_m, distance)
        low, high = np.radians(config.pitch_deg)
        return float(np.clip((weight * angles).sum() / weight.sum(), low, high))


STEP_S = 1 / 60


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Trajectory:
    """Densely sampled camera poses: `times_s` (N,) from 0, `world_from_camera` (N, 4, 4)."""

    times_s: NDArray[np.float64]
    world_from_camera: NDArray[np.float64]

    def __post_init__(self) -> None:
        freeze_all(self, np.float64, times_s=(None,), world_from_camera=(len(self.times_s), 4, 4))

    def pose_at(self, time_s: float) -> NDArray[np.float64]:
        """Return `world_from_camera` at a time within the walk."""
        i = int(np.clip(np.searchsorted(self.times_s, time_s, side="right") - 1, 0, len(self.times_s) - 2))
        fraction = (time_s - self.times_s[i]) / (self.times_s[i + 1] - self.times_s[i])
        return interpolate(self.world_from_camera[i], self.world_from_camera[i + 1], float(fraction))


@dataclass(frozen=True, kw_only=True, slots=True)
class NoWalk:
    """There is no loop with enough clearance."""

    clearance_m: float


def walk_round(world: World, seconds: float, config: "WalkConfig", rng: np.random.Generator) -> Trajectory | NoWalk:
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
    # Points (360, 2) on the ridge of the clearance around the centre, and the least clearance on it.
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
    closed = np.vstack([loop, loop[:1]])
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    on = np.mod(distances_m, arc[-1])
    return np.stack([np.interp(on, arc, closed[:, i]) for i in range(2)], axis=1)


def camera_poses(
    times_s: NDArray[np.float64],
    positions: NDArray[np.float64],
    yaw: NDArray[np.float64],
    pitch: NDArray[np.float64],
    config: "WalkConfig",
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


@dataclass(frozen=True, kw_only=True, slots=True)
class WalkConfig:
    """The speed, height, clearance and gaze of a walk."""

    speed_mps: float = 0.52
    eye_height_m: float = 1.38
    clearance_m: float = 0.28
    """The least distance from the camera's path to anything below 1.8 m."""
    max_yaw_rate_dps: float = 36.0
    bob_m: float = 0.012
    step_hz: float = 1.7
    pitch_deg: tuple[float, float] = (-30.0, -8.0)
    """The limits of pitch; negative is down."""
