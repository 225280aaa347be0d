"""What may be said about a log that it does not say itself; by default everything is discovered."""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT_MAX_POSE_GAP_NS = 500_000_000


@dataclass(frozen=True, kw_only=True, slots=True)
class SourceOptions:
    """Topics, tolerances and calibration of a source; None means: discover, or the default that is stated here.

    The topics are for logs and not used by image folders. `pose_frame` is the frame whose pose the pose topic gives:
    None is the message's own child frame. `sync_tolerance_ns` is the largest difference of stamps within a pair of
    colour and depth: None is half the period of the slower stream. `max_pose_gap_ns` is the widest gap between two
    poses over which is interpolated. `profile` is the calibration of an image folder, by its name in
    `players/profiles` or as a path: None is the profile of the folder's layout.
    """

    color_topic: str | None = None
    depth_topic: str | None = None
    color_info_topic: str | None = None
    depth_info_topic: str | None = None
    pose_topic: str | None = None
    pose_frame: str | None = None
    sync_tolerance_ns: int | None = None
    max_pose_gap_ns: int = DEFAULT_MAX_POSE_GAP_NS
    profile: str | None = None
