"""Options for what a log does not contain; by default everything is discovered."""

from dataclasses import dataclass
from pathlib import Path
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
    """Topics, tolerances and calibration of a source; None discovers the value, or takes the profile's."""

    color_topic: str | None = None
    depth_topic: str | None = None
    color_info_topic: str | None = None
    depth_info_topic: str | None = None
    pose_topic: str | None = None
    #: The frame whose pose the pose topic gives; None is the message's child frame.
    pose_frame: str | None = None
    #: Largest difference of stamps in a pair; None is half the period of the slower stream.
    sync_tolerance_ns: int | None = number(None, 0, MAX_GAP_NS, "ns")
    #: Widest gap across which poses are interpolated; None is 0.5 s.
    max_pose_gap_ns: int | None = number(None, 1, MAX_GAP_NS, "ns")
    #: A name in `players/profiles` or a path; None fits the topics or the layout, "none" is no profile.
    profile: str | None = None
    #: The robot's name in the topics, for profiles with one.
    robot: str | None = None
    #: Poses as text (TUM, or CSV with a header) in place of a pose topic.
    pose_file: Path | None = None
    #: Stamps of the headers ("header"), of the recording ("log"), or of usable headers, else the log ("auto").
    clock: Clock = "auto"
    #: "topic", a sensor ("lidar", "depth") or a method; "auto" estimates if the log has no poses.
    odometry: OdometryChoice = "auto"
    #: The camera's pose on the body: of TF or the profile ("log"), or estimated from motion ("estimate").
    extrinsics: Literal["log", "estimate"] = "log"

    @property
    def estimates_poses(self) -> bool:
        """Whether poses are to be estimated even if the log has some."""
        return self.odometry not in ("auto", "topic")
