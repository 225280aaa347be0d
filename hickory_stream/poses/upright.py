"""The vertical of a room from one scan: floors and tables face up, walls stand upright.

For the world of a hand-held camera's odometry; gravity is better if it is known.
"""

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import compose, from_rotation_translation, invert, rotation_of_vector
from hickory_stream.records import Scan

_TILTED_RAD = np.radians(50.0)
_LEVEL_COSINE = np.cos(np.radians(6.0))
_UPRIGHT_COSINE = np.sin(np.radians(6.0))
_LEAST_LEVEL_SHARE = 0.05
_LEAST_SHARE = 0.35
_POINTS_M, _LEAST_POINTS = 0.05, 100
_CANDIDATES = 400
_ROUNDS = 3
# One of so many scans is asked for its vertical. It errs by half a degree, alike in neighbouring scans, and odometry
# tilts by a fiftieth of a degree from scan to scan: the gain of a Kalman filter.
_LEVELLED_EVERY, _GAIN = 5, 0.1
# A ramp, a bed or a sofa, not the drift of odometry.
_RAMP_SINE = 0.07


class LevelledPoses:
    """Poses of a sensor by its odometry, which tilts slowly, in a world that stays upright."""

    def __init__(self) -> None:
        self._last: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._num_placed = 0

    def placed(
        self, world_from_start: NDArray[np.float64], start_from_sensor: NDArray[np.float64], scan: Scan
    ) -> NDArray[np.float64]:
        """Return the pose (4, 4) of the next scan; `world_from_start` (4, 4) counts for the first one."""
        pose = compose(world_from_start, start_from_sensor)
        if self._last is not None:
            start_from_last, world_from_last = self._last
            pose = compose(world_from_last, invert(start_from_last), start_from_sensor)
            expected = pose[2, :3]
            self._num_placed += 1
            up = up_in(scan, expected) if self._num_placed % _LEVELLED_EVERY == 0 else None
            tilt = np.zeros(3) if up is None else np.cross(up, expected)
            if 0.0 < portable.norm(tilt) < _RAMP_SINE:
                pose = compose(pose, from_rotation_translation(rotation_of_vector(_GAIN * tilt), np.zeros(3)))
        self._last = (start_from_sensor, pose)
        return pose


def up_in(scan: Scan, rough_up: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Return the unit vector up (3,) in the frame of a scan of a room, within 50 degrees of `rough_up` (3,).

    The normal to which most surfaces are level or upright, refined by the mean. None if too few are, or none is level:
    walls alone leave one tilt open.
    """
    import small_gicp

    if len(scan.points) < _LEAST_POINTS:
        return None
    cloud, _ = small_gicp.preprocess_points(scan.points.astype(np.float64), _POINTS_M, 20, 1)
    normals = np.asarray(cloud.normals())[:, :3] if cloud.size() else np.empty((0, 3))
    normals = normals[np.isfinite(normals).all(axis=1) & (np.abs((normals * normals).sum(axis=1) - 1) < 0.1)]
    if len(normals) < _LEAST_POINTS:
        return None
    rough = rough_up / np.sqrt((rough_up * rough_up).sum())
    facing = normals * np.where((normals * rough).sum(axis=1) < 0, -1.0, 1.0)[:, None]
    near = facing[(facing * rough).sum(axis=1) > np.cos(_TILTED_RAD)]
    if len(near) < _LEAST_LEVEL_SHARE * len(normals):
        return None
    candidates = near[:: max(1, len(near) // _CANDIDATES)]
    cosines = np.abs(candidates @ normals.T)
    votes = (cosines > _LEVEL_COSINE).sum(axis=1) + (cosines < _UPRIGHT_COSINE).sum(axis=1)
    up = candidates[int(votes.argmax())]
    for _ in range(_ROUNDS):
        level = facing[(facing * up).sum(axis=1) > _LEVEL_COSINE]
        up = level.mean(axis=0)
        up = up / np.sqrt((up * up).sum())
    cosines = np.abs((normals * up).sum(axis=1))
    is_level = cosines > _LEVEL_COSINE
    if is_level.mean() < _LEAST_LEVEL_SHARE or (is_level | (cosines < _UPRIGHT_COSINE)).mean() < _LEAST_SHARE:
        return None
    return np.asarray(up, dtype=np.float64)
