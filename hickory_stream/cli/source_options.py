"""Options of a log, shared by `play` and `doctor`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.option_values import parse_nanoseconds
from hickory_stream.errors import InputError

if TYPE_CHECKING:
    import argparse

    from players import SourceOptions


def add_source_options(command: argparse.ArgumentParser) -> None:
    """Add the options to a command."""
    topics = command.add_argument_group("options of a log; missing ones are discovered")
    for role in ("color", "depth", "color-info", "depth-info", "pose"):
        text = "none: ignore the poses of the log" if role == "pose" else None
        topics.add_argument(f"--{role}-topic", metavar="TOPIC", help=text)
    topics.add_argument("--pose-frame", metavar="FRAME", help="frame of the poses in the pose topic")
    topics.add_argument("--poses", type=Path, metavar="FILE", help="poses from a TUM or CSV file instead of a topic")
    topics.add_argument("--sync-tolerance", type=float, metavar="MS", help="between colour and depth (half a period)")
    topics.add_argument("--max-pose-gap", type=float, metavar="MS", help="between poses that are interpolated")
    topics.add_argument("--profile", metavar="NAME", help="kind of log: a name, a TOML file, or none")
    topics.add_argument("--robot", action="append", metavar="NAME", help="robot of a profile with several robots")
    topics.add_argument(
        "--odometry",
        choices=("auto", "topic", "lidar", "depth", "small_gicp", "kiss-icp"),
        default="auto",
        help="source of poses: the pose topic, else LiDAR, else depth (auto), or a method",
    )
    topics.add_argument(
        "--extrinsics",
        choices=("log", "estimate"),
        default="log",
        help="the camera's pose on the body: from TF or the profile (log), or estimated from motion",
    )
    topics.add_argument("--clock", choices=("auto", "header", "log"), default="auto", help="source of the stamps")


def add_anyway(command: argparse.ArgumentParser) -> None:
    """Add the option that maps what would be refused."""
    command.add_argument("--anyway", action="store_true", help="map a log whose poses and depth do not fit each other")


def source_options(options: argparse.Namespace) -> SourceOptions:
    """Return the options of a log; raises `InputError` for invalid values."""
    from players import SourceOptions

    gap_ms = options.max_pose_gap
    if gap_ms is not None and not 0 < gap_ms < float("inf"):
        raise InputError(f"found --max-pose-gap {gap_ms:g}, expected milliseconds, more than 0")
    return SourceOptions(
        color_topic=options.color_topic,
        depth_topic=options.depth_topic,
        color_info_topic=options.color_info_topic,
        depth_info_topic=options.depth_info_topic,
        pose_topic=options.pose_topic,
        pose_frame=options.pose_frame,
        pose_file=options.poses,
        sync_tolerance_ns=parse_nanoseconds(options.sync_tolerance),
        max_pose_gap_ns=None if gap_ms is None else round(gap_ms * 1e6),
        profile=options.profile,
        robot=options.robot[-1] if options.robot else None,
        clock=options.clock,
        odometry=options.odometry,
        extrinsics=options.extrinsics,
    )
