"""The odometry of a name of `--odometry`."""

from typing import assert_never

from hickory_stream.ports import Odometry
from hickory_stream.poses.kiss_icp_odometry import KissIcpOdometry
from hickory_stream.poses.odometry_config import DEFAULT_METHOD, MethodName, Sensor
from hickory_stream.poses.voxel_map_odometry import VoxelMapOdometry


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
