"""Real walks without their poses: errors of odometry and of the map, and the loops of the map, right and wrong."""
# The poses of the canteen are the device's own tracking, good to 1 to 4 cm. Results are cached under `--state`.

import os
import tempfile
import time
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.trajectory_error import trajectory_error
from hickory_stream.geometry.rigid import compose, invert, rotation_angle_rad
from hickory_stream.ports import Source
from players import SourceOptions, open_source
from players.options import NO_TOPIC, OdometryChoice
from tools.benchmarks.common.cached_runs import cached, play_into, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import NO_SHAPES, ROOT
from tools.benchmarks.poses.drift import CONFIG, keyframe_poses
from tools.benchmarks.poses.drift_logs import Poses
from tools.benchmarks.poses.loop_walks import closed_loops

# The figures of odometry on a log begin with its prefix.
_LOGS = {"canteen": ("canteen_odometry", "tuned on"), "redkitchen": ("depth_odometry", "reported only")}


def data_folder() -> Path:
    return Path(os.environ.get("HICKORY_DATA") or ROOT.parent / "shared" / "data")


def real_figures(options: Options) -> list[Figure]:
    """Return the figures of each real walk that is there; a quick run has those of odometry alone."""
    folder, figures = state_folder(options.state, "real"), list[Figure]()
    for name, (prefix, role) in _LOGS.items():
        log = data_folder() / name
        if not log.is_dir():
            continue
        runs = {"": partial(estimated, log)}
        runs |= {} if options.quick else {"kiss": partial(estimated, log, "kiss-icp"), "map": partial(_mapped, log)}
        found = {key: cached(folder / f"{name}{key}.json", run) for key, run in runs.items()}
        own, of = found[""], f"{found['']['frames']} frames, {found['']['way_m']:.1f} m, {found['']['by']}"
        rows = [
            (f"{prefix}_ate_m", own["ate_m"], "m", "lower", of),
            (f"{prefix}_end_deg", own["end_deg"], "deg", "lower", "rotation, first to last frame"),
            (f"{prefix}_degenerate", own["degenerate"], "", "lower", f"of {own['frames']} scans"),
        ]
        if not options.quick:
            own, of = found["map"], f"{found['map']['poses']} keyframes in the map, {found['map']['kept_out']} kept out"
            rows += [
                (f"{prefix.replace('odometry', 'kiss_icp')}_ate_m", found["kiss"]["ate_m"], "m", "lower"),
                (f"{name}_ate_m", own["ate_m"], "m", "lower", of),
                (f"{name}_end_deg", own["end_deg"], "deg", "lower", "rotation, first to last keyframe"),
                (f"{name}_loops", own["right"], "", "higher", f"right ones, {own['rejected']} rejected"),
                (f"{name}_wrong_loops", own["wrong"], "", "lower", "believed"),
            ]
        figures += [figure(*row, role=role) for row in rows]
    return figures


def _poses(source: Source) -> Poses:
    poses = {raw.stamp_ns: raw.world_from_camera for raw in source.frames()}
    source.close()
    return poses


def _without_poses(log: Path, choice: OdometryChoice = "depth") -> Source:
    return open_source(log, SourceOptions(pose_topic=NO_TOPIC, odometry=choice))


def estimated(log: Path, choice: OdometryChoice = "depth") -> dict[str, Any]:
    """Return the errors, the digest and the time of odometry on the frames of a log, without its poses."""
    true, source, started_s = _poses(open_source(log)), _without_poses(log, choice), time.process_time()
    poses = _poses(source)
    ms = 1e3 * (time.process_time() - started_s) / len(true)
    errors, counts, by = _errors(poses, true), source.ledger(), dict(source.info.streams)["pose"]
    more = {"frames": len(true), "degenerate": counts.get("odometry_degenerate", 0), "by": by, "ms": ms}
    return {**errors, **more, "digest": sha256(np.array(list(poses.values())).tobytes()).hexdigest()}


def _mapped(log: Path) -> dict[str, Any]:
    true = _poses(open_source(log))
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        play_into(out, _without_poses(log), read_config(MapperConfig, None, (*CONFIG, NO_SHAPES)))
        return {**_errors(keyframe_poses(out)[1], true), **asdict(closed_loops(out, true))}


def _errors(poses: Poses, true: Poses) -> dict[str, Any]:
    found, there = (np.array([each[stamp_ns] for stamp_ns in sorted(poses)]) for each in (poses, true))
    error = trajectory_error(sorted(poses), found, sorted(poses), there)
    step, true_step = (compose(invert(each[0]), each[-1]) for each in (found, there))
    end_deg = float(np.degrees(rotation_angle_rad(true_step[:3, :3].T @ step[:3, :3])))
    drift = error.ate_m / error.way_m
    return {"ate_m": error.ate_m, "way_m": error.way_m, "drift": drift, "end_deg": end_deg, "poses": len(poses)}
