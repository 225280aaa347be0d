"""The odometry of a name of `--odometry`."""

from importlib import import_module
from typing import Any, assert_never

import numpy as np
from numpy.typing import NDArray

from hickory_stream.errors import ModelError
from hickory_stream.ports import NotRegistered, Odometry, Registered
from hickory_stream.poses.odometry_config import (
    DEFAULT_METHOD,
    MethodName,
    OdometryConfig,
    Sensor,
    config_of,
    typical_range_m,
)
from hickory_stream.poses.voxel_map_odometry import VoxelMapOdometry
from hickory_stream.records import Scan


def make_odometry(sensor: Sensor, method: MethodName | None = None) -> Odometry:
    """Return a fresh odometry for a sensor's scans; None: its default. Raises `ModelError` without the library."""
    chosen = method or DEFAULT_METHOD[sensor]
    match chosen:
        case "small_gicp":
            return VoxelMapOdometry(sensor)
        case "kiss-icp":
            return KissIcpOdometry(sensor)
        case _:
            assert_never(chosen)


# Odometry by the library KISS-ICP (Vizzo et al., RA-L 2023), on one thread.
# It gives no uncertainty and no degenerate directions: in a corridor it stands still unnoticed.
class KissIcpOdometry:
    """An `Odometry` that passes each scan to KISS-ICP, with its own prediction by constant velocity."""

    def __init__(self, sensor: Sensor) -> None:
        """Load the library; raises `ModelError` if it is not installed."""
        try:
            import_module("kiss_icp.kiss_icp")
        except ImportError as error:
            text = f"kiss-icp cannot be loaded ({error}); `pip install kiss-icp`, or choose --odometry small_gicp"
            raise ModelError(text) from error
        self._sensor, self._config = sensor, OdometryConfig()
        self._method: Any = None

    @property
    def name(self) -> str:
        """The name by which `--odometry` chooses it."""
        return "kiss-icp"

    def register(self, scan: Scan, last_from_scan: NDArray[np.float64] | None = None) -> Registered | NotRegistered:
        """Return KISS-ICP's pose of the scan."""
        del last_from_scan
        if len(scan.points) < self._config.least_points:
            return NotRegistered(reason=f"{len(scan.points)} points; expected {self._config.least_points} and more")
        if self._method is None:
            self._method = self._made(scan)
        times = scan.times_s if scan.times_s is not None else np.empty(0)
        self._method.register_frame(scan.points.astype(np.float64), times.astype(np.float64))
        pose = np.asarray(self._method.last_pose, dtype=np.float64)
        return Registered(stamp_ns=scan.stamp_ns, start_from_sensor=pose, information=None, degenerate=np.empty((0, 6)))

    def _made(self, first: Scan) -> Any:
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        own = self._config = config_of(self._sensor, typical_range_m(first))
        config = KISSConfig()
        config.data.max_range = own.max_range_m
        config.data.deskew = first.times_s is not None
        config.mapping.voxel_size = own.kiss_voxel_m
        config.adaptive_threshold.initial_threshold = own.kiss_threshold_m
        config.registration.max_num_threads = 1
        return KissICP(config)
