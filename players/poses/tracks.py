"""Poses over time from a stream: interpolated, but neither over gaps nor across jumps.

Poses far apart in time (visual odometry at 5 Hz) are joined by a cubic; linear interpolation is off by millimetres.
After a jump of the odometry, poses continue in the world frame before it; the jump is reported for the submaps.
"""

import math
from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.portable_kernels import arccos, arctan2
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    interpolate,
    invert,
    rotation_of_vector,
    rotation_vector,
    yaw_rotation,
)
from players.poses.interpolation import HOLD_NS, pose_of_row

STANDING_M, STANDING_RAD = 0.02, 0.02
"""Poses closer than this, at any interval, mean that the robot stood still, when visual odometry makes no keyframes."""

ASIDE_M = 0.03
"""Distance of a pose from the middle of its neighbours, beyond their own distance, that no motion of a robot makes."""

_LEAST_ALIGNED = 5

_MAX_STANDING_NS = 30_000_000_000

SLOW_NS = 45_000_000
"""Poses further apart in time than this are interpolated by a cubic."""


@dataclass(frozen=True, kw_only=True, slots=True)
class JumpLimits(Ranged):
    """Limits of plausible motion between two poses, compared with a prediction of constant velocity.

    Limits in time: `acceleration_mps2` adds displacement to `jump_m`, `turn_radps` adds rotation to `jump_rad`.
    """

    jump_m: float = number(0.15, 0.001, 1000, "m")
    acceleration_mps2: float = number(5.0, 0, 1000, "m/s2")
    jump_rad: float = number(0.2, 0.001, 3.15, "rad")
    turn_radps: float = number(3.5, 0, 1000, "rad/s")
    speed_mps: float = number(4.0, 0, 1000, "m/s")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Jump:
    """A jump of the odometry at `stamp_ns`: `after_from_before` (4, 4) transforms from its old to its new world."""

    stamp_ns: int
    after_from_before: NDArray[np.float64]


class GrowingTrack:
    """Poses a_from_b, added roughly in the order of their stamps."""

    def __init__(self, max_gap_ns: int, limits: JumpLimits | None) -> None:
        self._max_gap_ns = max_gap_ns
        self._limits = limits
        self._stamps_ns: list[int] = []
        self._rows: dict[int, tuple[float, ...]] = {}
        self._odd: tuple[int, tuple[float, ...]] | None = None
        self.is_constant = True
        self.num_added = 0
        self.num_teleports = 0
        self.num_duplicates = 0
        self._aside: tuple[float, ...] | None = None
        self._num_aligned = 0
        #: Poses that lie aside of those before and after them, all in one direction: those of another publisher.
        self.num_rivals = 0
        self.jumps: list[Jump] = []
        self.first_ns: int | None = None

    def reaches(self, stamp_ns: int) -> bool:
        """Return whether the pose at a stamp is final: two poses behind it if they are rare, else one."""
        after = bisect_left(self._stamps_ns, stamp_ns)
        left = len(self._stamps_ns) - after
        if left == 0 or after == 0 or self._stamps_ns[after] == stamp_ns:
            return left > 0
        return left > 1 or self._stamps_ns[after] - self._stamps_ns[after - 1] <= SLOW_NS

    @property
    def newest_ns(self) -> int | None:
        """The newest stamp with a final pose, None before the first."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    def add(self, stamp_ns: int, row: Sequence[float]) -> None:
        """Add a pose tx ty tz qx qy qz qw; an implausible one is held back until the next one confirms it or not."""
        pose = tuple(row)
        if stamp_ns in self._rows:
            self.num_duplicates += 1
            self.num_rivals += self._limits is not None and _distance(self._rows[stamp_ns], pose) > ASIDE_M
            self.is_constant = self.is_constant and _is_equal(self._rows[stamp_ns], pose)
            return
        newest = self.newest_ns
        is_usual = self._limits is None or newest is None or stamp_ns < newest or self._continues(stamp_ns, pose)
        if is_usual and not self._is_beside_odd(stamp_ns, pose):
            if self._odd is not None:
                self.num_teleports += 1
                if newest is not None and stamp_ns > newest:
                    self._compare(self._rows[newest], self._odd[1], pose)
                self._odd = None
            elif self._limits is not None and newest is not None and stamp_ns > newest:
                self._compare_newest(pose)
            self._keep(stamp_ns, pose)
        elif self._odd is not None and self._is_reachable(self._odd, (stamp_ns, pose)):
            odd_ns, odd = self._odd
            self._odd = None
            self._compare_newest(odd)
            predicted = self._predicted(odd_ns)
            self.jumps.append(Jump(stamp_ns=odd_ns, after_from_before=_upright(_pose(odd), predicted)))
            self._keep(odd_ns, odd)
            self._keep(stamp_ns, pose)
        else:
            if self._odd is not None:
                self.num_teleports += 1
            self._odd = (stamp_ns, pose)

    def at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """Return the pose (4, 4) at a stamp, None outside the track."""
        if not self._stamps_ns:
            return None
        after = bisect_left(self._stamps_ns, stamp_ns)
        if after < len(self._stamps_ns) and self._stamps_ns[after] == stamp_ns:
            return self._pose_at(stamp_ns)
        if 0 < after < len(self._stamps_ns):
            start_ns, end_ns = self._stamps_ns[after - 1], self._stamps_ns[after]
            if self._is_joined(start_ns, end_ns):
                if end_ns - start_ns > SLOW_NS:
                    return self._cubic(after, stamp_ns)
                fraction = (stamp_ns - start_ns) / (end_ns - start_ns)
                return interpolate(self._pose_at(start_ns), self._pose_at(end_ns), fraction)
        near = [self._stamps_ns[i] for i in (after - 1, after) if 0 <= i < len(self._stamps_ns)]
        nearest = min(near, key=lambda ns: abs(ns - stamp_ns))
        return self._pose_at(nearest) if abs(nearest - stamp_ns) <= HOLD_NS else None

    def any_pose(self) -> NDArray[np.float64]:
        """Return the latest pose, which is every pose of a constant track."""
        return _pose(self._rows[self._stamps_ns[-1]])

    def jump_between(self, start_ns: int, end_ns: int) -> Jump | None:
        """Return the last jump after one stamp and not after another."""
        return next((jump for jump in reversed(self.jumps) if start_ns < jump.stamp_ns <= end_ns), None)

    def forget(self, before_ns: int) -> None:
        """Drop poses before a stamp, a few thousand at a time; the last two are always kept."""
        cut = min(bisect_left(self._stamps_ns, before_ns) - 1, len(self._stamps_ns) - 2)
        if cut > 2000:
            for stamp_ns in self._stamps_ns[:cut]:
                del self._rows[stamp_ns]
            del self._stamps_ns[:cut]

    def _pose_at(self, stamp_ns: int) -> NDArray[np.float64]:
        pose = _pose(self._rows[stamp_ns])
        for jump in reversed(self.jumps):
            if jump.stamp_ns <= stamp_ns:
                pose = compose(invert(jump.after_from_before), pose)
        return pose

    def _cubic(self, after: int, stamp_ns: int) -> NDArray[np.float64]:
        # Cubic Hermite spline; rotations are rotation vectors relative to the pose before, which are small.
        first, last = after - 1, after
        if first > 0 and self._is_joined(self._stamps_ns[first - 1], self._stamps_ns[first]):
            first -= 1
        if last + 1 < len(self._stamps_ns) and self._is_joined(self._stamps_ns[last], self._stamps_ns[last + 1]):
            last += 1
        stamps_ns = self._stamps_ns[first : last + 1]
        poses = [self._pose_at(ns) for ns in stamps_ns]
        origin = self._stamps_ns[after - 1]
        base = poses[after - 1 - first]
        times_s = np.array([(ns - origin) / 1e9 for ns in stamps_ns])
        turns = [rotation_vector(portable.matmul(base[:3, :3].T, p[:3, :3])) for p in poses]
        points = np.array([np.concatenate([p[:3, 3], turn]) for p, turn in zip(poses, turns, strict=True)])
        values = _hermite(times_s, points, after - 1 - first, (stamp_ns - origin) / 1e9)
        return from_rotation_translation(portable.matmul(base[:3, :3], rotation_of_vector(values[3:])), values[:3])

    def _keep(self, stamp_ns: int, row: tuple[float, ...]) -> None:
        if self._stamps_ns and self.is_constant:
            self.is_constant = _is_equal(self._rows[self._stamps_ns[-1]], row)
        if self.first_ns is None or stamp_ns < self.first_ns:
            self.first_ns = stamp_ns
        if not self._stamps_ns or stamp_ns > self._stamps_ns[-1]:
            self._stamps_ns.append(stamp_ns)
        else:
            insort(self._stamps_ns, stamp_ns)
        self._rows[stamp_ns] = row
        self.num_added += 1

    def _compare_newest(self, after: tuple[float, ...]) -> None:
        if len(self._stamps_ns) > 1:
            self._compare(self._rows[self._stamps_ns[-2]], self._rows[self._stamps_ns[-1]], after)

    def _compare(self, before: tuple[float, ...], now: tuple[float, ...], after: tuple[float, ...]) -> None:
        x, y, z = now[0] - before[0], now[1] - before[1], now[2] - before[2]
        if 4.0 * (x * x + y * y + z * z) < ASIDE_M * ASIDE_M:
            return
        aside = tuple(b - 0.5 * (a + c) for a, b, c in zip(before[:3], now[:3], after[:3], strict=True))
        length = portable.norm(aside)
        if length < max(ASIDE_M, _distance(before, after)):
            return
        if self._aside is not None:
            along = abs(sum(a * b for a, b in zip(aside, self._aside, strict=True)))
            # Noise has no direction.
            is_aligned = along > 0.9 * length * portable.norm(self._aside)
            self._num_aligned = self._num_aligned + 1 if is_aligned else 0
            self.num_rivals += self._num_aligned >= _LEAST_ALIGNED
        self._aside = aside

    def _is_joined(self, start_ns: int, end_ns: int) -> bool:
        if any(start_ns < jump.stamp_ns <= end_ns for jump in self.jumps):
            return False
        if end_ns - start_ns <= self._max_gap_ns:
            return True
        if end_ns - start_ns > _MAX_STANDING_NS:
            return False
        start, end = self._rows[start_ns], self._rows[end_ns]
        return _distance(start, end) <= STANDING_M and _angle(start, end) <= STANDING_RAD

    def _continues(self, stamp_ns: int, row: tuple[float, ...]) -> bool:
        assert self._limits is not None
        newest_ns = self._stamps_ns[-1]
        dt_s = (stamp_ns - newest_ns) / 1e9
        if stamp_ns - newest_ns > 2 * self._max_gap_ns:
            return True  # no prediction after a long gap
        last = self._rows[newest_ns]
        if _angle(last, row) > self._limits.jump_rad + self._limits.turn_radps * dt_s:
            return False
        velocity = self._velocity()
        if velocity is None:
            return _distance(last, row) <= self._limits.jump_m + self._limits.speed_mps * dt_s
        predicted = tuple(p + v * dt_s for p, v in zip(last[:3], velocity, strict=True))
        return _distance(predicted, row) <= self._limits.jump_m + 0.5 * self._limits.acceleration_mps2 * dt_s * dt_s

    def _velocity(self) -> tuple[float, ...] | None:
        # Over at least 20 ms before the newest pose.
        newest_ns = self._stamps_ns[-1]
        i = bisect_left(self._stamps_ns, newest_ns - 20_000_000 + 1) - 1
        if i < 0 or not self._is_joined(self._stamps_ns[i], newest_ns):
            return None
        dt_s = (newest_ns - self._stamps_ns[i]) / 1e9
        before, last = self._rows[self._stamps_ns[i]], self._rows[newest_ns]
        return tuple((b - a) / dt_s for a, b in zip(before[:3], last[:3], strict=True))

    def _is_beside_odd(self, stamp_ns: int, row: tuple[float, ...]) -> bool:
        # Over two long intervals a jump is a plausible motion, too: the odd pose explains the next one better.
        if self._odd is None or stamp_ns < self._odd[0] or not self._is_reachable(self._odd, (stamp_ns, row)):
            return False
        velocity = self._velocity() or (0.0, 0.0, 0.0)
        ends = ((self._stamps_ns[-1], self._rows[self._stamps_ns[-1]]), self._odd)
        usual_m, odd_m = (
            _distance([p + v * (stamp_ns - ns) / 1e9 for p, v in zip(pose[:3], velocity, strict=True)], row)
            for ns, pose in ends
        )
        return odd_m < usual_m

    def _is_reachable(self, a: tuple[int, tuple[float, ...]], b: tuple[int, tuple[float, ...]]) -> bool:
        assert self._limits is not None
        dt_s = abs(b[0] - a[0]) / 1e9
        is_near = _distance(a[1], b[1]) <= self._limits.jump_m + self._limits.speed_mps * dt_s
        return is_near and _angle(a[1], b[1]) <= self._limits.jump_rad + self._limits.turn_radps * dt_s

    def _predicted(self, stamp_ns: int) -> NDArray[np.float64]:
        newest_ns = self._stamps_ns[-1]
        last = _pose(self._rows[newest_ns])
        i = bisect_left(self._stamps_ns, newest_ns - 20_000_000 + 1) - 1
        if i < 0 or not self._is_joined(self._stamps_ns[i], newest_ns):
            return last
        before = _pose(self._rows[self._stamps_ns[i]])
        share = (stamp_ns - newest_ns) / (newest_ns - self._stamps_ns[i])
        turn = rotation_vector(portable.matmul(before[:3, :3].T, last[:3, :3]))
        position = last[:3, 3] + share * (last[:3, 3] - before[:3, 3])
        return from_rotation_translation(portable.matmul(last[:3, :3], rotation_of_vector(share * turn)), position)


def _hermite(times_s: NDArray[np.float64], points: NDArray[np.float64], i: int, time_s: float) -> NDArray[np.float64]:
    # Points (N, D) at times (N,); the tangents are of parabolas.
    steps = np.diff(times_s)
    slopes = np.diff(points, axis=0) / steps[:, None]

    def tangent(j: int) -> NDArray[np.float64]:
        if j == 0 or j == len(points) - 1:
            return np.asarray(slopes[min(j, len(slopes) - 1)])
        weight = steps[j] / (steps[j - 1] + steps[j])
        return np.asarray(weight * slopes[j - 1] + (1.0 - weight) * slopes[j])

    step = float(steps[i])
    t = (time_s - float(times_s[i])) / step
    return np.asarray(
        (1 + 2 * t) * (1 - t) * (1 - t) * points[i]
        + t * (1 - t) * (1 - t) * step * tangent(i)
        + t * t * (3 - 2 * t) * points[i + 1]
        + t * t * (t - 1) * step * tangent(i + 1)
    )


def _pose(row: Sequence[float]) -> NDArray[np.float64]:
    return pose_of_row(np.asarray(row, dtype=np.float64))


def _upright(after: NDArray[np.float64], before: NDArray[np.float64]) -> NDArray[np.float64]:
    # Both worlds have z up: a tilt would be how far a walking body pitches otherwise than predicted.
    turn = portable.matmul(after[:3, :3], before[:3, :3].T)
    rotation = yaw_rotation(arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))
    return from_rotation_translation(rotation, after[:3, 3] - portable.matmul(rotation, before[:3, 3]))


def _is_equal(a: Sequence[float], b: Sequence[float]) -> bool:
    return max(abs(x - y) for x, y in zip(a, b, strict=True)) < 1e-9


def _distance(a: Sequence[float], b: Sequence[float]) -> float:
    return math.sqrt(sum((x - y) * (x - y) for x, y in zip(a[:3], b[:3], strict=True)))


def _angle(a: Sequence[float], b: Sequence[float]) -> float:
    # Directly from the quaternions, since it runs for every pose.
    dot = abs(sum(x * y for x, y in zip(a[3:], b[3:], strict=True)))
    lengths = math.sqrt(sum(x * x for x in a[3:]) * sum(x * x for x in b[3:]))
    return float(2.0 * arccos(min(1.0, dot / lengths)))
