"""Options for what a log does not contain; by default everything is discovered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path  # noqa: TC003 -- `from_dict` looks the types up
from typing import Literal

from hickory_stream.base.ranges import Ranged, number

DEFAULT_MAX_POSE_GAP_NS = 500_000_000
MAX_GAP_NS = 3_600_000_000_000
"""The maximum of both tolerances; larger values are taken for mistakes."""

Clock = Literal["auto", "header", "log"]

OdometryChoice = Literal["auto", "topic", "lidar", "depth", "small_gicp", "kiss-icp"]
NO_TOPIC = "none"
"""The `pose_topic` that makes a log be played as if it had no poses."""


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceOptions(Ranged):
    """Topics, tolerances and calibration of a source; None is the profile's value, or as stated here.

    Attributes:
        color_topic, depth_topic, color_info_topic, depth_info_topic, pose_topic: for logs only; None discovers them.
        pose_frame: the frame whose pose the pose topic gives; None is the message's child frame.
        sync_tolerance_ns: the largest difference of stamps within a pair of colour and depth; None is half the period
            of the slower stream.
        max_pose_gap_ns: the widest gap between two poses across which poses are interpolated; None is 0.5 s.
        profile: a name in `players/profiles` or a path; None is the profile that fits the topics or the layout, "none"
            is no profile.
        robot: the robot's name in the topics, for profiles with one.
        pose_file: poses as text (TUM, or CSV with a header) in place of a pose topic.
        clock: the stamps that are used: of the headers ("header"), of the recording ("log"), or of the headers unless
            they are unusable ("auto").
        odometry: the origin of the poses: the pose topic ("topic"), estimates from "lidar" or "depth", or from the
            method of that name, on the LiDAR if there is one, else on depth; "auto" estimates if the log has no poses.
        extrinsics: the camera's pose on the body of the pose topic: from TF or the profile ("log"), or estimated from
            the motion ("estimate").
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
        """Whether poses are to be estimated even if the log has some."""
        return self.odometry not in ("auto", "topic")
