"""Configuration of odometry: sizes in metres, by the sensor."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.records import Scan

Sensor = Literal["lidar", "depth"]
MethodName = Literal["small_gicp", "kiss-icp"]

# The better method on the data of `tools/bench poses`; the README of this package has the figures.
DEFAULT_METHOD: dict[Sensor, MethodName] = {"lidar": "small_gicp", "depth": "small_gicp"}


@dataclass(frozen=True, kw_only=True, slots=True)
class OdometryConfig(Ranged):
    """Sizes and limits of odometry.

    Attributes:
        voxel_m: the local map keeps one distribution of points per voxel of this size.
        points_m: a scan is registered by one point per voxel of this size.
        num_neighbors: points from which the surface around a point is estimated.
        gate_m: points farther from the map than this are no correspondences.
        max_iterations: of one registration.
        kept_scans: voxels that so many scans have not touched leave the local map.
        least_points: a scan of fewer points cannot be registered.
        least_share: nor one of which a smaller share of points lies on the map.
        jump_m, jump_rad: a result farther from the prediction than this is none.
        strong_cosine: only surfaces whose normals are within this of a direction speak for a motion along it
            (X-ICP: Tuna et al., T-RO 2024: noise of the others' normals looks like knowledge where there is none).
        least_strong: a direction for which fewer such points speak is degenerate.
    """

    voxel_m: float = number(0.1, 0.01, 20, "m")
    points_m: float = number(0.03, 0.005, 10, "m")
    num_neighbors: int = number(10, 4, 100, "points")
    gate_m: float = number(0.5, 0.01, 50, "m")
    max_iterations: int = number(20, 1, 1000, "iterations")
    kept_scans: int = number(200, 1, 1_000_000, "scans")
    least_points: int = number(100, 10, 1_000_000, "points")
    least_share: float = number(0.15, 0, 1, "share")
    jump_m: float = number(0.5, 0.01, 100, "m")
    jump_rad: float = number(0.6, 0.01, 3.15, "rad")
    strong_cosine: float = number(0.6, 0, 1, "ratio")
    least_strong: float = number(40.0, 0, 1e6, "points")
    kiss_voxel_m: float = number(0.1, 0.01, 20, "m")
    kiss_threshold_m: float = number(0.3, 0.01, 20, "m")
    max_range_m: float = number(100.0, 0.1, 1000, "m")


_DEPTH = OdometryConfig()


def config_of(sensor: Sensor, typical_range_m: float) -> OdometryConfig:
    """Return the configuration for a sensor; a LiDAR's sizes grow with its typical range (of the first scan)."""
    # A street is 10 m and more away and takes voxels of a metre, as in KISS-ICP; the walls of a room are 3 m away.
    if sensor == "depth":
        return _DEPTH
    voxel_m = min(max(0.1 * typical_range_m, 0.1), 1.0)
    return OdometryConfig(
        voxel_m=voxel_m,
        points_m=0.25 * voxel_m,
        gate_m=2.0 * voxel_m,
        jump_m=max(2.0, 2.0 * voxel_m),
        least_strong=60.0,
        kiss_voxel_m=voxel_m,
        kiss_threshold_m=2.0,
    )


def typical_range_m(scan: Scan) -> float:
    """Return the median distance of a scan's points."""
    return float(np.median(np.sqrt(np.square(scan.points.astype(np.float64)).sum(axis=1))))
