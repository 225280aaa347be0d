"""Keyframe selection from stamps and poses alone, before anything is decoded."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.ranges import Ranged, number
from hickory_stream.geometry import portable
from hickory_stream.geometry.rigid import rotation_angle_rad


@dataclass(frozen=True, kw_only=True, slots=True)
class KeyframeConfig(Ranged):
    """When a frame is a keyframe."""

    #: Minimum time since the last keyframe.
    min_interval_s: float = number(0.25, 0, 3600, "s")
    #: Minimum translation since the last keyframe; the minimum rotation suffices as well.
    min_distance_m: float = number(0.15, 0, 100, "m")
    #: Minimum rotation since the last keyframe; the minimum translation suffices as well.
    min_angle_deg: float = number(5.0, 0, 180, "deg")
    #: After this time a frame is a keyframe without any motion.
    max_interval_s: float = number(2.0, 0, 3600, "s")


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Keyframe:
    """The stamp and the pose of a keyframe."""

    stamp_ns: int
    world_from_camera: NDArray[np.float64]


KeyframeReason = Literal["first", "moved", "at_rest"]
"""Why a frame is a keyframe; the first frame is one, and the first after a jump back."""


def is_keyframe(
    last: Keyframe | None, stamp_ns: int, world_from_camera: NDArray[np.float64], config: KeyframeConfig
) -> bool:
    """Return whether a frame is the next keyframe."""
    return keyframe_reason(last, stamp_ns, world_from_camera, config) is not None


def keyframe_reason(
    last: Keyframe | None, stamp_ns: int, world_from_camera: NDArray[np.float64], config: KeyframeConfig
) -> KeyframeReason | None:
    """Return why a frame is the next keyframe, None if it is not."""
    if last is None or stamp_ns < last.stamp_ns:
        return "first"
    elapsed_ns = stamp_ns - last.stamp_ns
    # A millisecond of slack: stamps of a 20 Hz log are 50 ms apart only on average.
    if elapsed_ns < config.min_interval_s * 1e9 - 1_000_000:
        return None
    distance_m, turned_rad = motion(last.world_from_camera, world_from_camera)
    if distance_m >= config.min_distance_m or turned_rad >= np.deg2rad(config.min_angle_deg):
        return "moved"
    return "at_rest" if elapsed_ns >= config.max_interval_s * 1e9 - 1_000_000 else None


def motion(world_from_first: NDArray[np.float64], world_from_second: NDArray[np.float64]) -> tuple[float, float]:
    """Return the translation of a camera between two poses, in metres, and its rotation, in radians."""
    distance_m = portable.norm(world_from_second[:3, 3] - world_from_first[:3, 3])
    return distance_m, rotation_angle_rad(portable.matmul(world_from_first[:3, :3].T, world_from_second[:3, :3]))
