"""Odometry by registration against a local voxel map: generalised ICP of the library small_gicp.

Segal, Haehnel and Thrun, Generalized-ICP (RSS 2009), against Gaussian voxels (Koide et al., ICRA 2021), on one thread,
which fixes the order of sums. This module adds the prediction, and the tests whether to believe a result.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import (
    compose,
    from_rotation_translation,
    invert,
    quaternion_from_rotation,
    rotation_angle_rad,
    rotation_from_quaternion,
    rotation_of_vector,
    rotation_vector,
)
from hickory_stream.ports import NotRegistered, Registered
from hickory_stream.poses.degeneracy import Surfels, degenerate_directions, surfels_of, without_degenerate
from hickory_stream.poses.odometry_config import OdometryConfig, Sensor, config_of, typical_range_m
from hickory_stream.poses.surface_alignment import solved
from hickory_stream.records import Scan

Matrix = NDArray[np.float64]

# After a longer gap the motion before it is no prediction.
MAX_STEP_NS = 1_000_000_000


class ConstantVelocity:
    """The last two poses of a sensor, and their extrapolation."""

    def __init__(self) -> None:
        self._last: tuple[int, Matrix] | None = None
        self._step: tuple[int, Matrix] | None = None

    @property
    def last(self) -> Matrix | None:
        """The newest pose (4, 4)."""
        return None if self._last is None else self._last[1]

    def since(self, stamp_ns: int) -> int | None:
        """Return the time from the newest pose to a stamp; None without a pose, or over more than one step."""
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
        """Return the motion (4, 4) within a duration, `before_from_after`; the identity if it is unknown."""
        if self._step is None or not 0 < duration_ns <= MAX_STEP_NS:
            return np.eye(4)
        return scaled_motion(self._step[1], duration_ns / self._step[0])

    def predicted(self, stamp_ns: int) -> Matrix:
        """Return the pose (4, 4) expected at a stamp; the start if there is no earlier one."""
        return np.eye(4) if self._last is None else compose(self._last[1], self.motion(stamp_ns - self._last[0]))


def scaled_motion(before_from_after: Matrix, share: float) -> Matrix:
    """Return a share of a motion (4, 4): of its rotation vector and of its translation."""
    turn = rotation_of_vector(share * rotation_vector(before_from_after[:3, :3]))
    return from_rotation_translation(turn, share * before_from_after[:3, 3])


def deskewed(points: NDArray[np.float32], times_s: NDArray[np.float32], velocity: Matrix) -> NDArray[np.float32]:
    """Return points (N, 3) of a sweep as seen at its stamp.

    `times_s` (N,) since the stamp; `velocity` (4, 4): motion within a second. Rodrigues' formula rotates each point.
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


# So many neighbouring points err alike: the share of the Hessian that counts as independent evidence.
_CORRELATED = 50.0
_CLEAR_EVERY = 10
_NOTHING = 1e-6
# A direction that features determine to this is not degenerate.
_KNOWN_M, _KNOWN_RAD = 0.02, 0.01
# One of so many points is tested for degenerate directions, with so many around it.
_TESTED_EVERY, _TESTED_NEIGHBORS = 8, 25


class VoxelMapOdometry:
    """An `Odometry` that keeps the distributions of points in voxels, and registers each scan to them."""

    def __init__(self, sensor: Sensor) -> None:
        self._sensor, self._config = sensor, OdometryConfig()
        self._map: Any = None
        self._motion = ConstantVelocity()

    @property
    def name(self) -> str:
        """The name by which `--odometry` chooses it."""
        return "small_gicp"

    def register(
        self, scan: Scan, last_from_scan: Matrix | None = None, measured: Matrix | None = None
    ) -> Registered | NotRegistered:
        """Return the pose of the scan, or the reason why it has none; then the map does not change.

        `measured` (6, 6): the information of `last_from_scan` in the scan's frame, if another sensor measured it. A
        registration that is far from there does not count.
        """
        predicted = self._predicted(scan, last_from_scan)
        if len(scan.points) < self._config.least_points:
            return NotRegistered(reason=f"{len(scan.points)} points; expected {self._config.least_points} and more")
        if self._map is None:
            return self._begin(scan)
        cloud, surfels = self._cloud(scan, predicted)
        found = self._aligned(cloud, predicted)
        reason = self._why_not(cloud, found) or self._why_too_far(found, predicted)
        # A registration may slide away from a measured pose at which the scan lies on the map.
        is_off = reason is not None and measured is not None
        against = self._why_not(cloud, self._aligned(cloud, predicted, 1)) if is_off else reason
        if against is not None:
            return NotRegistered(reason=against)
        limits = {"strong_cosine": self._config.strong_cosine, "least_strong": self._config.least_strong}
        degenerate = degenerate_directions(surfels, **limits) if reason is None else np.eye(6)
        information = _information(found, degenerate) if reason is None else np.zeros((6, 6))
        registered = _rigid(found.T_target_source) if reason is None else predicted
        start_from_sensor = without_degenerate(registered, predicted, degenerate)
        if measured is not None:
            start_from_sensor = joined(predicted, measured, registered, information)
            information = information + measured
            degenerate = np.array([each for each in degenerate if not _is_known(each, measured)]).reshape(-1, 6)
        self._map.insert(cloud, start_from_sensor)
        self._motion.add(scan.stamp_ns, start_from_sensor)
        result = {"start_from_sensor": start_from_sensor, "information": information, "degenerate": degenerate}
        return Registered(stamp_ns=scan.stamp_ns, **result)

    def _predicted(self, scan: Scan, last_from_scan: NDArray[np.float64] | None) -> NDArray[np.float64]:
        last = self._motion.last
        if last is None or last_from_scan is None:
            return self._motion.predicted(scan.stamp_ns)
        return compose(last, last_from_scan)

    def _begin(self, scan: Scan) -> Registered:
        # The range of the first scan sets the sizes.
        import small_gicp

        self._config = config_of(self._sensor, typical_range_m(scan))
        self._map = small_gicp.GaussianVoxelMap(self._config.voxel_m)
        self._map.set_lru(horizon=self._config.kept_scans, clear_cycle=_CLEAR_EVERY)
        self._map.insert(self._cloud(scan, np.eye(4))[0], np.eye(4))
        self._motion.add(scan.stamp_ns, np.eye(4))
        start = {"start_from_sensor": np.eye(4), "information": np.zeros((6, 6)), "degenerate": np.empty((0, 6))}
        return Registered(stamp_ns=scan.stamp_ns, **start)

    def _cloud(self, scan: Scan, pose: NDArray[np.float64]) -> tuple[Any, Surfels]:
        # The scan, deskewed and thinned out, and its surfels.
        import small_gicp

        points = scan.points
        if scan.times_s is not None and len(points) and float(np.ptp(scan.times_s)) > 0:
            last, duration_ns = self._motion.last, self._motion.since(scan.stamp_ns)
            if last is not None and duration_ns is not None:
                velocity = scaled_motion(compose(invert(last), pose), 1e9 / duration_ns)
                points = deskewed(points, scan.times_s, velocity)
        thin = small_gicp.voxelgrid_sampling(points.astype(np.float64), self._config.points_m)
        tree = small_gicp.KdTree(thin)
        places = thin.points()[:, :3]
        neighbors, _ = tree.batch_knn_search(places[::_TESTED_EVERY], _TESTED_NEIGHBORS, 1)
        surfels = surfels_of(places, neighbors, _TESTED_EVERY)
        small_gicp.estimate_normals_covariances(thin, tree, self._config.num_neighbors, 1)
        return thin, surfels

    def _aligned(self, cloud: Any, predicted: Matrix, max_iterations: int | None = None) -> Any:
        import small_gicp

        return small_gicp.align(
            self._map,
            cloud,
            init_T_target_source=predicted,
            max_correspondence_distance=self._config.gate_m,
            num_threads=1,
            max_iterations=max_iterations or self._config.max_iterations,
        )

    def _why_not(self, cloud: Any, found: Any) -> str | None:
        # Why a scan cannot be placed, None where it can.
        config = self._config
        if cloud.size() < config.least_points:
            return f"{cloud.size()} points after thinning out; expected {config.least_points} and more"
        share = found.num_inliers / cloud.size()
        if not share >= config.least_share:
            return f"{share:.0%} of the points lie on the map; expected {config.least_share:.0%} and more"
        return None

    def _why_too_far(self, found: Any, predicted: Matrix) -> str | None:
        config = self._config
        step = compose(invert(predicted), found.T_target_source)
        moved_m = float(np.sqrt((step[:3, 3] * step[:3, 3]).sum()))
        turned_rad = rotation_angle_rad(step[:3, :3])
        if not (moved_m <= config.jump_m and turned_rad <= config.jump_rad):
            return f"it would be {moved_m:.2f} m and {np.degrees(turned_rad):.0f} degrees from where motion leads"
        return None


def joined(measured: Matrix, by_measured: Matrix, registered: Matrix, by_registered: Matrix) -> Matrix:
    """Return the most likely pose (4, 4) of two, each with its information (6, 6) in the sensor's frame."""
    step = compose(invert(measured), registered)
    off = np.concatenate([rotation_vector(step[:3, :3]), step[:3, 3]])
    total = by_measured + by_registered + _NOTHING * np.eye(6)
    moved = solved(total, portable.matmul(by_registered, off))
    return _rigid(compose(measured, from_rotation_translation(rotation_of_vector(moved[:3]), moved[3:])))


def _is_known(direction: NDArray[np.float64], information: Matrix) -> bool:
    spread = _KNOWN_RAD if np.abs(direction[:3]).any() else _KNOWN_M
    return portable.dot(direction, portable.matmul(information, direction)) >= 1.0 / (spread * spread)


def _rigid(matrix: NDArray[np.float64]) -> NDArray[np.float64]:
    # With an exact rotation: products of thousands of steps drift from it.
    rotation = rotation_from_quaternion(*quaternion_from_rotation(matrix[:3, :3]).tolist())
    return from_rotation_translation(rotation, matrix[:3, 3])


def _information(found: Any, degenerate: NDArray[np.float64]) -> NDArray[np.float64]:
    # (6, 6) the Hessian in units of its residuals, none along degenerate directions.
    variance = max(2.0 * found.error / max(3 * found.num_inliers - 6, 1), 1e-12)
    information = np.asarray(found.H, dtype=np.float64) / (variance * _CORRELATED)
    information = 0.5 * (information + information.T)
    for direction in degenerate:
        keep = np.eye(6) - np.outer(direction, direction)
        information = portable.matmul(portable.matmul(keep, information), keep)
    return information
