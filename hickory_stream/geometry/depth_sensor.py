"""The noise model of the depth camera: one record for all modules that need it, set by the log's profile.

    sigma(z) = max(floor_m, noise_m + noise_per_m z^2), with the camera's quantisation in the second term

Triangulation (stereo, structured light) errs by the same disparity everywhere, so that the noise in depth grows with z
squared (Khoshelham and Oude Elberink, Sensors 2012; Nguyen, Izadi and Lovell, 3DIMPVT 2012).
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, check_order, check_ranges, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.arrays import read_only

Law = tuple[float, float, float]
"""What `sigma_at` takes, in compiled code: the floor, the constant and the quadratic term, or a multiple of them."""

_FAR_M = 1000.0


@dataclass(frozen=True, kw_only=True, slots=True)
class DepthSensor(Ranged):
    """What a depth camera's returns are worth; the defaults are those of a camera of which nothing is known.

    Attributes:
        noise_per_m: standard deviation of depth over z^2: that of disparity over focal length times baseline.
        noise_m: what is added to it at every distance.
        floor_m: no return is surer than this.
        step_per_m: the camera's step in inverse depth: the step of disparity over focal length times baseline.
        min_m, max_m: what is nearer or farther is no return.
        edge_rad: beside a step of depth, the angle within which returns may be of either side.
        bias_m: the camera reports so much more than there is, at every distance; it is taken off.
    """

    noise_per_m: float = number(0.0025, 0, 1, "1/m")
    noise_m: float = number(0.0, 0, 1, "m")
    floor_m: float = number(0.001, 0, 1, "m")
    step_per_m: float = number(0.0, 0, 1, "1/m")
    min_m: float = number(0.2, 0, 100, "m")
    max_m: float = number(_FAR_M, 0.01, 1e4, "m")
    edge_rad: float = number(0.0045, 0, 1, "rad")
    bias_m: float = number(0.0, -1, 1, "m")

    def __post_init__(self) -> None:
        check_ranges(self)
        check_order(self, "min_m", "max_m")

    @property
    def spread_per_m(self) -> float:
        """The standard deviation of inverse depth, in 1/m: noise, and a step's, which is uniform."""
        if self.step_per_m == 0:
            return self.noise_per_m
        return float(np.sqrt(self.noise_per_m * self.noise_per_m + self.step_per_m * self.step_per_m / 12))

    @property
    def law(self) -> Law:
        """The standard deviation for compiled code."""
        return self.floor_m, self.noise_m, self.spread_per_m

    def sigma_m(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the standard deviation of each depth, in its shape; NaN where there is none."""
        sigma = self.spread_per_m * depth_m * depth_m + self.noise_m
        return np.maximum(sigma, np.float32(self.floor_m)).astype(np.float32)

    def reach_m(self, sigma_m: float) -> float:
        """Return the depth up to which the standard deviation is at most `sigma_m`."""
        left = sigma_m - self.noise_m
        if left <= 0 or sigma_m < self.floor_m:
            return 0.0
        return min(self.max_m, float(np.sqrt(left / self.spread_per_m))) if self.spread_per_m > 0 else self.max_m

    def edge_px(self, focal_px: float) -> int:
        """Return the pixels beside a step of depth within which returns may be of either side."""
        return round(self.edge_rad * focal_px)

    def returns(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return depth (H, W) as reported, without its bias and with NaN for what is out of range."""
        if self.bias_m != 0:
            depth_m = depth_m - np.float32(self.bias_m)
        if self.min_m > 0 or self.max_m < _FAR_M:
            flat = read_only(np.asarray(depth_m, dtype=np.float32)).ravel()
            depth_m = _between(flat, np.float32(self.min_m), np.float32(self.max_m)).reshape(depth_m.shape)
        elif self.bias_m > 0:
            depth_m = np.where(depth_m > 0, depth_m, np.float32(np.nan))
        return np.asarray(depth_m, dtype=np.float32)


@kernel
def _between(depth, low, high):
    # In one pass.
    out = np.empty(len(depth), np.float32)
    for i in range(len(depth)):
        out[i] = depth[i] if (low <= depth[i]) & (depth[i] <= high) else np.float32(np.nan)
    return out


@kernel
def sigma_at(z, law):
    """Return the standard deviation of a depth by the law of a `DepthSensor`."""
    return max(law[0], law[1] + law[2] * z * z)


def information(
    points_world: NDArray[np.float32], world_from_camera: NDArray[np.float64], law: Law
) -> NDArray[np.float32]:
    """Return 1 / sigma^2 of the depth of (N, 3) points that a camera sees."""
    axis = world_from_camera[:3, 2]
    depth = portable.matmul(points_world, axis[:, None])[:, 0] - portable.dot(axis, world_from_camera[:3, 3])
    return (1.0 / np.square(np.maximum(law[0], law[1] + law[2] * depth * depth))).astype(np.float32)


@dataclass(frozen=True, kw_only=True, slots=True)
class SensorConfig(Ranged):
    """The depth camera where the log's profile does not say, or is wrong; what is not set is the profile's.

    `doctor` estimates the noise from a log. The numbers are those of `DepthSensor`.
    """

    noise_per_m: float | None = number(None, 0, 1, "1/m")
    noise_m: float | None = number(None, 0, 1, "m")
    floor_m: float | None = number(None, 0, 1, "m")
    step_per_m: float | None = number(None, 0, 1, "1/m")
    min_m: float | None = number(None, 0, 100, "m")
    max_m: float | None = number(None, 0.01, 1e4, "m")
    edge_rad: float | None = number(None, 0, 1, "rad")
    bias_m: float | None = number(None, -1, 1, "m")

    def over(self, sensor: DepthSensor) -> DepthSensor:
        """Return a sensor with the numbers that are set in place of its own."""
        given: dict[str, Any] = {f.name: value for f in fields(self) if (value := getattr(self, f.name)) is not None}
        return replace(sensor, **given) if given else sensor
