"""Odometry by KISS-ICP (Vizzo et al., RA-L 2023), the library as it is, on one thread.

It says neither how sure it is nor along what it is blind: in a corridor it stands still, and nothing shows it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.errors import ModelError
from hickory_stream.ports import NotRegistered, Registered
from hickory_stream.poses.odometry_config import OdometryConfig, config_of, typical_range_m

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from hickory_stream.poses.odometry_config import Sensor
    from hickory_stream.records import Scan


class KissIcpOdometry:
    """An `Odometry` that hands each scan to KISS-ICP; its own constant velocity predicts, and nobody else."""

    def __init__(self, sensor: Sensor, config: OdometryConfig | None = None) -> None:
        """Load the library.

        Raises:
            ModelError: it is not installed.
        """
        try:
            import_module("kiss_icp.kiss_icp")
        except ImportError as error:
            raise ModelError(
                f"kiss-icp cannot be loaded ({error}); `pip install kiss-icp`, or choose --odometry small_gicp"
            ) from error
        self._sensor = sensor
        self._given = config
        self._config = config or OdometryConfig()
        self._method: Any = None

    @property
    def name(self) -> str:
        """The name by which `--odometry` chooses it."""
        return "kiss-icp"

    def register(self, scan: Scan, last_from_scan: NDArray[np.float64] | None = None) -> Registered | NotRegistered:
        """Return where KISS-ICP says that the scan was taken."""
        del last_from_scan
        if len(scan.points) < self._config.least_points:
            return NotRegistered(reason=f"{len(scan.points)} points; expected {self._config.least_points} and more")
        if self._method is None:
            self._method = self._made(scan)
        points, times = _as_kiss_icp_has_them(scan)
        self._method.register_frame(points, times)
        pose = np.asarray(self._method.last_pose, dtype=np.float64)
        return Registered(stamp_ns=scan.stamp_ns, start_from_sensor=pose, information=None, degenerate=np.empty((0, 6)))

    def _made(self, first: Scan) -> Any:
        """Return a fresh KissICP; the first scan says how coarse."""
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        own = self._config = self._given or config_of(self._sensor, typical_range_m(first))
        config = KISSConfig()
        config.data.max_range = own.max_range_m
        config.data.deskew = first.times_s is not None
        config.mapping.voxel_size = own.kiss_voxel_m
        config.adaptive_threshold.initial_threshold = own.kiss_threshold_m
        config.registration.max_num_threads = 1
        return KissICP(config)


def _as_kiss_icp_has_them(scan: Scan) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points and times of a scan as `register_frame` takes them."""
    times = scan.times_s if scan.times_s is not None else np.empty(0)
    return scan.points.astype(np.float64), times.astype(np.float64)
