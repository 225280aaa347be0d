"""`hickory-stream odometry`: estimate the camera's trajectory without mapping."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from hickory_stream.cli.output_files import add_output, disk_refusals
from hickory_stream.cli.source_options import add_source_options, source_options
from hickory_stream.errors import RecordingError
from hickory_stream.outputs import output

if TYPE_CHECKING:
    import argparse

    import numpy as np
    from numpy.typing import NDArray

    from hickory_stream.cli.commands import Commands
    from hickory_stream.evaluation.trajectory_error import TrajectoryError

    Trajectory = tuple[list[int], list[NDArray[np.float64]]]


def add(commands: Commands) -> None:
    odometry = commands.add("odometry", run)
    odometry.add_argument("source", nargs="+", metavar="LOG", help="logs as for play")
    add_output(
        odometry, "-o", "--out", type=Path, metavar="FILE", help="write the camera's poses (TUM: stamp, position, xyzw)"
    )
    odometry.add_argument(
        "--truth", type=Path, metavar="FILE|LOG", help="true poses of the camera (TUM, CSV), or a log with poses"
    )
    add_source_options(odometry)


def run(options: argparse.Namespace) -> int:
    from hickory_stream.base.atomic_files import write_output
    from players import open_source
    from players.opening import open_estimating

    asked = source_options(options)
    true = None if options.truth is None else _truth(options.truth)
    source = open_source(options.source, asked) if asked.odometry == "topic" else open_estimating(options.source, asked)
    started_s = time.process_time()
    try:
        stamps_ns, poses = [], []
        for raw in source.frames():
            stamps_ns.append(raw.stamp_ns)
            poses.append(raw.world_from_camera)
            if sys.stderr.isatty() and not options.json:
                sys.stderr.write(f"\r{len(poses)} frames")
        spent_s = time.process_time() - started_s
        ledger, by = dict(source.ledger()), dict(source.info.streams).get("pose", "")
    finally:
        source.close()
    if not poses:
        text = ", ".join(f"{name} {count}" for name, count in sorted(ledger.items())) or "nothing"
        raise RecordingError(f"{source.info.uri}: no frame got a pose ({text}); choose another --odometry")
    error = _error(stamps_ns, poses, true) if true is not None else None
    if options.out is not None:
        with disk_refusals(options.out, "poses"):
            write_output(options.out, tum_text(stamps_ns, poses).encode())
    counts = {name: ledger.get(f"odometry_{name}", 0) for name in ("lost", "degenerate", "scans")}
    if options.json:
        errors = None
        if error is not None:
            errors = asdict(error)
        said = {"poses": len(poses), "pose": by, **counts, "seconds": spent_s, "error": errors}
        print(output("odometry", said))
        return 0
    print(f"{len(poses)} poses of {by}; {spent_s / len(poses) * 1e3:.1f} ms of processor time a frame")
    print(
        f"{counts['scans']} scans registered, {counts['degenerate']} of them without hold along some direction; "
        f"{counts['lost']} frames without a pose"
    )
    if error is not None:
        print(
            f"ATE {error.ate_m:.4f} m (RMSE, aligned), RPE {error.rpe_m:.4f} m and {error.rpe_deg:.3f} degrees from "
            f"pose to pose; {error.num_poses} poses on a path of {error.way_m:.1f} m"
        )
    return 0


def tum_text(stamps_ns: list[int], poses: list[NDArray[np.float64]]) -> str:
    """Return poses (4, 4) in TUM format, one a line: seconds, position, quaternion with w last."""
    from hickory_stream.geometry.rigid import quaternion_from_rotation

    lines = ["# stamp tx ty tz qx qy qz qw: the camera (x right, y down, z forward) in the world"]
    for stamp_ns, pose in zip(stamps_ns, poses, strict=True):
        numbers = [*pose[:3, 3].tolist(), *quaternion_from_rotation(pose[:3, :3]).tolist()]
        lines.append(
            f"{stamp_ns // 1_000_000_000}.{stamp_ns % 1_000_000_000:09d} " + " ".join(f"{n:.9f}" for n in numbers)
        )
    return "\n".join(lines) + "\n"


def _truth(path: Path) -> Trajectory:
    import numpy as np

    from players import SourceOptions, open_source
    from players.poses.interpolation import pose_of_row
    from players.poses.pose_file import read_pose_file

    if path.is_file() and path.suffix in (".tum", ".txt", ".csv"):
        stamps_ns, rows = read_pose_file(path, None)
        order = sorted(range(len(stamps_ns)), key=stamps_ns.__getitem__)
        return [stamps_ns[i] for i in order], [pose_of_row(np.array(rows[i])) for i in order]
    source = open_source(path, SourceOptions(odometry="topic"))
    try:
        frames = [(raw.stamp_ns, raw.world_from_camera) for raw in source.frames()]
    finally:
        source.close()
    return [stamp_ns for stamp_ns, _ in frames], [pose for _, pose in frames]


def _error(stamps_ns: list[int], poses: list[NDArray[np.float64]], true: Trajectory) -> TrajectoryError:
    import numpy as np

    from hickory_stream.evaluation.trajectory_error import trajectory_error

    return trajectory_error(stamps_ns, np.array(poses), true[0], np.array(true[1]))
