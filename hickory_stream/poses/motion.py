"""Where a sensor is expected: motion goes on as it was, unless somebody knows better."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    rotation_of_vector,
    rotation_vector,
)

Matrix = NDArray[np.float64]

MAX_STEP_NS = 1_000_000_000
"""After a gap that is longer than this the motion before it says nothing."""


class ConstantVelocity:
    """The last two poses of a sensor, and where it would be if it went on."""

    def __init__(self) -> None:
        self._last: tuple[int, Matrix] | None = None
        self._step: tuple[int, Matrix] | None = None

    @property
    def last(self) -> Matrix | None:
        """The newest pose (4, 4)."""
        return None if self._last is None else self._last[1]

    def since(self, stamp_ns: int) -> int | None:
        """Return how long before a stamp the newest pose is; None where there is none, or the motion not one step."""
        if self._last is None or not 0 < stamp_ns - self._last[0] <= MAX_STEP_NS:
            return None
        return stamp_ns - self._last[0]

    def add(self, stamp_ns: int, start_from_sensor: Matrix) -> None:
        """Take the pose (4, 4) at a stamp."""
        self._step = None
        if self._last is not None and 0 < stamp_ns - self._last[0] <= MAX_STEP_NS:
            self._step = (stamp_ns - self._last[0], compose(invert(self._last[1]), start_from_sensor))
        self._last = (stamp_ns, start_from_sensor)

    def motion(self, duration_ns: int) -> Matrix:
        """Return the motion (4, 4) within a duration, `before_from_after`; none where nothing is known."""
        if self._step is None or not 0 < duration_ns <= MAX_STEP_NS:
            return np.eye(4)
        return scaled_motion(self._step[1], duration_ns / self._step[0])

    def predicted(self, stamp_ns: int) -> Matrix:
        """Return the pose (4, 4) expected at a stamp, the start where there was none before."""
        return np.eye(4) if self._last is None else compose(self._last[1], self.motion(stamp_ns - self._last[0]))


def scaled_motion(before_from_after: Matrix, share: float) -> Matrix:
    """Return a share of a motion (4, 4): of its rotation vector and of its translation."""
    turn = rotation_of_vector(share * rotation_vector(before_from_after[:3, :3]))
    return from_rotation_translation(turn, share * before_from_after[:3, 3])


def deskewed(points: NDArray[np.float32], times_s: NDArray[np.float32], velocity: Matrix) -> NDArray[np.float32]:
    """Return points (N, 3) of a sweep as the sensor would have seen them at its stamp.

    `times_s` (N,) since the stamp; `velocity` (4, 4) is the motion within a second. Of each point, the rotation about
    the motion's axis by Rodrigues' formula, and its share of the translation.
    """
    vector = rotation_vector(velocity[:3, :3])
    rate = portable.norm(vector)
    times = times_s.astype(np.float64)
    moved = points.astype(np.float64)
    if rate > 1e-9:
        axis = vector / rate
        angles = (rate * times)[:, None]
        along = (moved * axis).sum(axis=1)[:, None] * axis
        across = moved - along
        moved = along + across * portable.cos(angles) + np.cross(axis, across) * portable.sin(angles)
    return np.asarray(moved + times[:, None] * velocity[:3, 3], dtype=np.float32)
