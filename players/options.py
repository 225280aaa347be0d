"""Options for what a log does not say itself; by default everything is discovered."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from hickory_stream.ranges import Ranged, number

if TYPE_CHECKING:
    from pathlib import Path

DEFAULT_MAX_POSE_GAP_NS = 500_000_000
MAX_GAP_NS = 3_600_000_000_000
"""The maximum of both tolerances: longer ones are mistakes."""

Clock = Literal["auto", "header", "log"]

OdometryChoice = Literal["auto", "topic", "lidar", "depth", "small_gicp", "kiss-icp"]
NO_TOPIC = "none"
"""As `pose_topic`: a log is played as if it had no poses."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceOptions(Ranged):
    """Topics, tolerances and calibration of a source; None means: the profile's, or discover, or what is stated here.

    The topics are for logs and not used by image folders. `pose_frame` is the frame whose pose the pose topic gives:
    None is the message's own child frame. `sync_tolerance_ns` is the largest difference of stamps within a pair of
    colour and depth: None is the profile's, or half the period of the slower stream. `max_pose_gap_ns` is the widest
    gap between two poses over which is interpolated: None is the profile's, or 0.5 s. `profile` is what is known of the
    kind of log, by its name in `players/profiles` or as a path: None is the profile that the topics or the layout fit,
    "none" is no profile. `robot` is the robot's name in the topics, for profiles with one. `pose_file` holds poses as
    text (TUM, or CSV with a header) in place of a pose topic. `clock` is which stamps count: those of the headers
    ("header"), those of the recording ("log"), or the headers' unless they are of no use ("auto"). `odometry` is where
    poses come from: the pose topic ("topic"), estimates from "lidar" or "depth", or the method of that name on the
    LiDAR, where there is none on depth; "auto" estimates where the log has no poses. `extrinsics` is where the camera
    sits on the body whose poses the log has: as TF or the profile say ("log"), or by its motion ("estimate").
    """

    color_topic: str | None = None
    depth_topic: str | None = None
    color_info_topic: str | None = None
    depth_info_topic: str | None = None
    pose_topic: str | None = None
    pose_frame: str | None = None
    sync_tolerance_ns: int | None = number(None, 0, MAX_GAP_NS, "ns")
    max_pose_gap_ns: int | None = number(None, 1, MAX_GAP_NS, "ns")
    profile: str | None = None
    robot: str | None = None
    pose_file: Path | None = None
    clock: Clock = "auto"
    odometry: OdometryChoice = "auto"
    extrinsics: Literal["log", "estimate"] = "log"

    @property
    def estimates_poses(self) -> bool:
        """Whether odometry is asked for, whatever poses the log has."""
        return self.odometry not in ("auto", "topic")
