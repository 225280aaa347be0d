"""What opening determined about a log."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hickory_stream.geometry.depth_sensor import DepthSensor
    from players.logs.containers import Topic
    from players.logs.topic_discovery import ImageTopics
    from players.messages.calibration import Lens
    from players.messages.depth_registration import Registration
    from players.poses.camera_poses import PosePlan
    from players.poses.tf import FrameTree
    from players.poses.tracks import JumpLimits
    from players.profile import Corrections, RigLinks


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class LogSetup:
    """The topics, lenses, poses and tolerances by which a log is played.

    `tree` and `rig` are the frames of TF and of the profile, by which a LiDAR is connected to the `color_frame`.
    """

    topics: ImageTopics
    small_topics: tuple[Topic, ...]
    color_lens: Lens
    depth_lens: Lens
    registration: Registration
    plan: PosePlan
    max_gap_ns: int
    jump_limits: JumpLimits
    pose_file: tuple[list[int], list[list[float]]] | None
    tolerance_ns: int
    uses_log_time: bool
    depth_units_per_m: float
    sensor: DepthSensor
    corrections: Corrections
    has_float_depth: bool
    streams: tuple[tuple[str, str], ...]
    is_live: bool = False
    estimates_poses: bool = False
    tree: FrameTree | None = None
    rig: RigLinks | None = None
    color_frame: str = ""
    #: The frames of colour and depth if TF connects them.
    depth_ends: tuple[str, str] | None = None
    findings: tuple[str, ...] = ()
