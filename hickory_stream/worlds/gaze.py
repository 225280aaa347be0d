"""The viewing direction of a camera that is carried through a world.

The gaze is planned a few looks ahead. It turns to the objects that have been seen least, and to unseen sides of them,
at no more than the angular rate of a head. Objects in other rooms are ignored.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import gaussian_filter1d

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.worlds.scene import World
    from hickory_stream.worlds.walk_config import WalkConfig

_DECISION_S = 1.2
_LOOKAHEAD = 3


def gaze(
    world: World,
    positions: NDArray[np.float64],
    step_s: float,
    config: WalkConfig,
    *,
    first_yaw: float | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return smooth (N,) yaw and pitch angles of the optical axis; `first_yaw` None looks at the middle of the room."""
    steps = round(_DECISION_S / step_s)
    attention = _Attention(world)
    if first_yaw is None:
        first_yaw = _heading(attention.middle_of_room(positions[0]) - positions[0])
    yaw = first_yaw
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
    """Which objects have been seen from which sides, and the gain of a further look at each."""

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
        """Return the centre (2,) of the room that contains a position."""
        return np.asarray(self._middles[self._room(position)])

    def _room(self, position: NDArray[np.float64]) -> int:
        """Return the room that contains an (x, y) position, or the nearest one."""
        outside = np.maximum(0.0, np.maximum(self._rooms[:, :2] - position, position - self._rooms[:, 2:]))
        return int(np.argmin((outside**2).sum(axis=1)))

    def best_turn(self, stops: NDArray[np.float64], yaw: float, turn_rad: float) -> float:
        """Return the turn in -1..1 that starts the best sequence of looks from the next few stops."""
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
        """Return for each object how well it is seen (N,), 0 if it is not visible, and from which side (N,)."""
        offset = self._centers[:, :2] - position
        distance = np.linalg.norm(offset, axis=1)
        bearing = np.arctan2(offset[:, 1], offset[:, 0])
        off_axis = np.abs(np.angle(np.exp(1j * (bearing - yaw))))
        quality = np.minimum(1.0, (self._reach_m / np.maximum(distance, 1e-3)) ** 2)
        quality[(off_axis > np.radians(34)) | (distance < 0.8) | (self._room_of != self._room(position))] = 0.0
        side = np.floor(np.mod(bearing, 2 * np.pi) / (2 * np.pi) * self._SIDES).astype(np.int64) % self._SIDES
        return quality, side

    def _gains(self, position: NDArray[np.float64], yaw: float) -> NDArray[np.float64]:
        """Return (N,) what a look adds to each object."""
        quality, side = self._view(position, yaw)
        novelty = 1.0 / (1.0 + 2.0 * self._looks[np.arange(len(side)), side] + self._looks.sum(axis=1))
        return quality * novelty * self._weights

    def look(self, position: NDArray[np.float64], yaw: float) -> None:
        """Record a look from a position in a direction."""
        quality, side = self._view(position, yaw)
        self._looks[np.arange(len(side)), side] += quality

    def pitch(self, position: NDArray[np.float64], yaw: float, config: WalkConfig) -> float:
        """Return the pitch (negative = down) that centres the objects worth looking at, within its limits."""
        weight = self._gains(position, yaw) + 1e-3
        distance = np.linalg.norm(self._centers[:, :2] - position, axis=1)
        angles = np.arctan2(self._centers[:, 2] - config.eye_height_m, distance)
        low, high = np.radians(config.pitch_deg)
        return float(np.clip((weight * angles).sum() / weight.sum(), low, high))
