"""Poses over time: interpolated, never extrapolated.

Beyond the ends, and in a wide gap, the nearest pose holds for up to `HOLD_NS`.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import freeze
from hickory_stream.geometry.rigid import (
    from_rotation_translation,
    interpolate,
    quaternion_from_rotation,
    rotation_from_quaternion,
)

HOLD_NS = 20_000_000
"""How long a pose replaces a missing one: at 1 m/s and 1 rad/s, an error of 2 cm and 1.1 degrees."""


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class PoseTrack:
    """Poses a_from_b over time, made by `track_of`.

    `stamps_ns` (N,) strictly increasing, N >= 1; `rows` (N, 7) = tx ty tz qx qy qz qw, half the size of matrices.
    """

    stamps_ns: NDArray[np.int64]
    rows: NDArray[np.float64]
    max_gap_ns: int

    def __post_init__(self) -> None:
        freeze(self, "stamps_ns", np.int64, (None,))
        freeze(self, "rows", np.float64, (len(self.stamps_ns), 7))

    @property
    def span_ns(self) -> tuple[int, int]:
        """The first and the last stamp."""
        return int(self.stamps_ns[0]), int(self.stamps_ns[-1])

    def at(self, stamp_ns: int) -> NDArray[np.float64] | None:
        """Return the pose (4, 4) at a stamp, None outside the track."""
        after = int(np.searchsorted(self.stamps_ns, stamp_ns))
        if after < len(self.stamps_ns) and self.stamps_ns[after] == stamp_ns:
            return pose_of_row(self.rows[after])
        if 0 < after < len(self.stamps_ns):
            start_ns, end_ns = int(self.stamps_ns[after - 1]), int(self.stamps_ns[after])
            if end_ns - start_ns <= self.max_gap_ns:
                fraction = (stamp_ns - start_ns) / (end_ns - start_ns)
                return interpolate(pose_of_row(self.rows[after - 1]), pose_of_row(self.rows[after]), fraction)
        near = [i for i in (after - 1, after) if 0 <= i < len(self.stamps_ns)]
        nearest = min(near, key=lambda i: abs(int(self.stamps_ns[i]) - stamp_ns))
        is_held = abs(int(self.stamps_ns[nearest]) - stamp_ns) <= HOLD_NS
        return pose_of_row(self.rows[nearest]) if is_held else None


def track_of(
    stamps_ns: Sequence[int], rows: Sequence[Sequence[float]] | NDArray[np.float64], max_gap_ns: int
) -> PoseTrack | None:
    """Return the track of poses given in any order, None without poses; of several with one stamp the first is kept."""
    if not len(stamps_ns):
        return None
    unique_ns, first = np.unique(np.asarray(stamps_ns, dtype=np.int64), return_index=True)
    poses = np.asarray(rows, dtype=np.float64).reshape(-1, 7)[first]
    return PoseTrack(stamps_ns=unique_ns, rows=poses, max_gap_ns=max_gap_ns)


def is_pose_row(row: Sequence[float]) -> bool:
    """Return whether tx ty tz qx qy qz qw is a pose: finite, with a non-zero quaternion (which is normalised later)."""
    # Called for every pose, several times a frame: for seven numbers Python is faster than NumPy.
    return all(map(math.isfinite, row)) and sum(x * x for x in row[3:]) > 1e-6


def pose_of_row(row: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pose (4, 4) of tx ty tz qx qy qz qw."""
    return from_rotation_translation(rotation_from_quaternion(*row[3:].tolist()), row[:3])


def row_of_pose(pose: NDArray[np.float64]) -> list[float]:
    """Return tx ty tz qx qy qz qw of a pose (4, 4)."""
    return [*pose[:3, 3].tolist(), *quaternion_from_rotation(pose[:3, :3]).tolist()]


def nearest_rigid(a_from_b: NDArray[Any], tolerance: float = 0.02) -> NDArray[np.float64] | None:
    """Return the rigid transform nearest to a (4, 4) or (3, 4) matrix of a log, None if the matrix is far from rigid.

    The rotation is projected onto SO(3) by singular value decomposition; matrices printed as text are orthogonal to a
    few digits only.
    """
    if not np.isfinite(a_from_b).all():
        return None
    u, singular, vt = portable.svd3(a_from_b[:3, :3])
    rotation = portable.matmul(u, vt)
    if np.abs(singular - 1.0).max() > tolerance or portable.det3(rotation) < 0:
        return None
    return from_rotation_translation(rotation, a_from_b[:3, 3])


def world_from_down(down: NDArray[Any]) -> NDArray[np.float64]:
    """Return the smallest rotation (4, 4) that takes the direction `down` (3,) to (0, 0, -1)."""
    up = -np.asarray(down, dtype=np.float64) / portable.norm(down)
    if up[2] < -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0, 1.0])
    # Rodrigues' formula for the rotation from `up` to z, written without the angle: 1 / (1 + cos).
    cross = np.array([[0.0, 0.0, -up[0]], [0.0, 0.0, -up[1]], [up[0], up[1], 0.0]])
    rotation = np.eye(3) + cross + portable.matmul(cross, cross) / (1.0 + up[2])
    return from_rotation_translation(rotation, np.zeros(3))
