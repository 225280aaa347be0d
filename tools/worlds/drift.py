"""Odometry with drift: a true trajectory with the errors of dead reckoning."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import from_rotation_translation, invert, yaw_rotation
from hickory_stream.worlds.trajectory import Trajectory


@dataclass(frozen=True, kw_only=True, slots=True)
class DriftConfig:
    """Standard deviations of the drift of odometry; 0 is exact."""

    #: Error of the distance travelled, as a share of it.
    scale: float = 0.01
    yaw_deg_per_m: float = 0.05
    #: The distance over which both errors are correlated.
    correlation_m: float = 8.0


def drift_of(factor: float) -> DriftConfig:
    """Return so many times the default drift."""
    default = DriftConfig()
    return DriftConfig(scale=factor * default.scale, yaw_deg_per_m=factor * default.yaw_deg_per_m)


def drifted(trajectory: Trajectory, config: DriftConfig, rng: np.random.Generator) -> Trajectory:
    """Return the trajectory as odometry reports it."""
    return replace(trajectory, world_from_camera=drifted_poses(trajectory.world_from_camera, config, rng))


def drifted_poses(true: NDArray[np.float64], config: DriftConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return poses (N, 4, 4) as odometry reports them: the first is true, and the vertical has no error."""
    poses = np.empty_like(true)
    poses[0] = true[0]
    scale, yaw = rng.standard_normal(2)
    for i in range(1, len(true)):
        step = invert(true[i - 1]) @ true[i]
        moved_m = float(np.linalg.norm(step[:3, 3]))
        keep = np.exp(-moved_m / config.correlation_m)
        fresh = np.sqrt(1 - keep**2) * rng.standard_normal(2)
        scale, yaw = keep * scale + fresh[0], keep * yaw + fresh[1]
        step[:3, 3] *= 1.0 + config.scale * scale
        pose = poses[i - 1] @ step
        # A rotation about the vertical axis through the camera: it changes the heading, not the position.
        turn = yaw_rotation(np.radians(config.yaw_deg_per_m) * yaw * moved_m)
        poses[i] = from_rotation_translation(turn @ pose[:3, :3], pose[:3, 3])
    return poses
