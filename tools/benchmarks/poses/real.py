"""Real data: walks by given poses, with drift put on and without poses; a street by LiDAR; public pose graphs."""
# The poses of the canteen are the device's own tracking, good to 1 to 4 cm. Results are cached under `--state`. Objects
# of two maps are the same at IoU 0.25; the two are placed as the ATE places their keyframes.

import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from hashlib import sha256
from itertools import pairwise, zip_longest
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.evaluation.trajectory_error import trajectory_error
from hickory_stream.geometry.boxes import box_iou
from hickory_stream.geometry.rigid import apply, compose, from_rotation_translation, invert, rotation_angle_rad
from hickory_stream.geometry.voxels import are_near, keys_of_points, sorted_unique
from hickory_stream.mapping.entities.rigid_motion import moved_box
from hickory_stream.ports import Registered, Source
from hickory_stream.poses.choose import make_odometry
from hickory_stream.poses.odometry_config import MethodName
from hickory_stream.records import Scan
from players import SourceOptions, open_source
from players.options import NO_TOPIC, OdometryChoice
from tools.benchmarks.common.cached_runs import cached, cached_map, play_into, state_folder
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import NO_SHAPES, ROOT
from tools.benchmarks.poses.drift import CONFIG, keyframe_poses, map_from_world
from tools.benchmarks.poses.drift_logs import Poses, drifting, moved_to
from tools.benchmarks.poses.loop_walks import closed_loops
from tools.benchmarks.poses.pose_graphs import public_figures

# The figures of odometry on a log begin with its prefix.
_LOGS = {"canteen": ("canteen_odometry", "tuned on"), "redkitchen": ("depth_odometry", "reported only")}


def data_folder() -> Path:
    return Path(os.environ.get("HICKORY_DATA") or ROOT.parent / "shared" / "data")


def real_figures(options: Options) -> list[Figure]:
    """Return the figures of real walks, of a street by LiDAR, and of public pose graphs, of those that are there."""
    # A quick run has odometry alone, and the small graphs.
    folder, figures = state_folder(options.state, "real"), list[Figure]()
    for name, (prefix, role) in _LOGS.items():
        log = data_folder() / name
        if not log.is_dir():
            continue
        runs = {"": partial(estimated, log)}
        if not options.quick:
            runs |= {"kiss": partial(estimated, log, "kiss-icp")}
            runs |= {how: partial(_mapped, log, folder, how) for how in ("given", "map", "drift")}
        found = {key: cached(folder / f"{name}{key}.json", run) for key, run in runs.items()}
        own, of = found[""], f"{found['']['frames']} frames, {found['']['way_m']:.1f} m, {found['']['by']}"
        rows: list[tuple[Any, ...]] = [
            (f"{prefix}_ate_m", own["ate_m"], "m", "lower", of),
            (f"{prefix}_end_deg", own["end_deg"], "deg", "lower", "rotation, first to last frame"),
            (f"{prefix}_degenerate", own["degenerate"], "", "lower", f"of {own['frames']} scans"),
        ]
        if not options.quick:
            rows.append((f"{prefix.replace('odometry', 'kiss_icp')}_ate_m", found["kiss"]["ate_m"], "m", "lower"))
            for how, ours in {"given": f"{name}_given", "map": name, "drift": f"{name}_drift"}.items():
                rows += _map_rows(ours, found[how], is_given=how == "given")
        figures += [figure(*row, role=role) for row in rows]
    figures += _street(data_folder() / "kitti_lidar", quick=options.quick)
    return [*figures, *public_figures(data_folder() / "graphs", options)]


def _map_rows(name: str, own: dict[str, Any], *, is_given: bool) -> list[tuple[Any, ...]]:
    of = f"{own['poses']} keyframes in the map, {own['kept_out']} kept out"
    of += f"; {own['before_m']:.3f} m before" if "before_m" in own else ""
    rows: list[tuple[Any, ...]] = [
        (f"{name}_ate_m", own["ate_m"], "m", "lower", of),
        (f"{name}_end_deg", own["end_deg"], "deg", "lower", "rotation, first to last keyframe"),
        (f"{name}_loops", own["right"], "", "higher", f"right ones, {own['rejected']} rejected"),
        (f"{name}_wrong_loops", own["wrong"], "", "lower", "believed"),
    ]
    return rows if is_given else [
        *rows,
        (f"{name}_kept", own["kept"], "", "higher", f"of {own['given']} objects of the map with given poses"),
        (f"{name}_also_given", own["also_given"], "", "higher", f"the other way, of {own['found']}"),
        (f"{name}_doubles", own["doubles"], "", "lower", "objects that the map with given poses has as one"),
    ]  # fmt: skip


def _street(folder: Path, *, quick: bool) -> list[Figure]:
    # Twelve sweeps of a road, without given poses: without any, and with motions given that are a percent too long.
    files = sorted(folder.glob("*.pcd"))
    if not files:
        return []
    scans = [Scan(stamp_ns=i * 100_000_000, frame="lidar", points=_points_of(file)) for i, file in enumerate(files)]
    poses = _swept(scans, "small_gicp")
    steps = np.array([compose(invert(a), b) for a, b in pairwise(poses)])
    figures = [
        figure("street_registered_fraction", len(poses) / len(scans)),
        figure("street_step_change_m", np.abs(np.diff(np.linalg.norm(steps[:, :3, 3], axis=1))).max(), "m", "lower"),
    ]
    if quick or len(poses) < len(scans):
        return figures
    drift = np.array([from_rotation_translation(step[:3, :3], 1.01 * step[:3, 3]) for step in steps])
    for name, other in (("kiss_icp", _swept(scans, "kiss-icp")), ("led", _swept(scans, "small_gicp", drift))):
        apart_m = float(np.linalg.norm(other[-1][:3, 3] - poses[-1][:3, 3]))
        of = f"ends apart, after {np.linalg.norm(poses[-1][:3, 3]):.1f} m"
        figures.append(figure(f"street_{name}_apart_m", apart_m, "m", "lower", of))
    return figures


def _swept(
    scans: Sequence[Scan], method: MethodName, given: NDArray[np.float64] | None = None
) -> list[NDArray[np.float64]]:
    odometry, steps = make_odometry("lidar", method), [None] if given is None else [None, *given]
    found = [odometry.register(scan, step) for scan, step in zip_longest(scans, steps)]
    return [each.start_from_sensor for each in found if isinstance(each, Registered)]


def _points_of(file: Path) -> NDArray[np.float32]:
    header, _, data = file.read_bytes().partition(b"DATA binary\n")
    count = next(int(line.split()[1]) for line in header.decode().splitlines() if line.startswith("POINTS"))
    return np.ascontiguousarray(np.frombuffer(data, np.float32, 4 * count).reshape(count, 4)[:, :3])


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


def _mapped(log: Path, folder: Path, how: str) -> dict[str, Any]:
    # By the given poses, without them, or with drift put on them.
    true, given = _poses(open_source(log)), folder / f"{log.name}-given"
    cached_map(given, lambda: open_source(log), *CONFIG, NO_SHAPES)
    if how == "given":
        return {**_errors(keyframe_poses(given)[1], true), **asdict(closed_loops(given, true))}
    with tempfile.TemporaryDirectory() as temporary:
        out = Path(temporary) / "map"
        drift = drifting(true, 1.0, [51])
        source = moved_to(open_source(log), drift) if how == "drift" else _without_poses(log)
        play_into(out, source, read_config(MapperConfig, None, (*CONFIG, NO_SHAPES)))
        found = {**_errors(keyframe_poses(out)[1], true), **asdict(closed_loops(out, true))}
        before = {"before_m": _errors(drift, true)["ate_m"]} if how == "drift" else {}
        return {**found, **before, **agreement(given, out)}


# Objects lie on one another in cells of this size: the poses err by less.
_CELL_M = 0.05


def agreement(given: Path, other: Path) -> dict[str, int]:
    """Return how many objects two maps of one log have in common, and the doubles of the other one."""
    # A double: one more object of the other map that lies by half on an object of the given one, and covers a fifth.
    (one, true), (two, poses) = keyframe_poses(given), keyframe_poses(other)
    both = sorted(true.keys() & poses.keys())
    moved = map_from_world({stamp: poses[stamp] for stamp in both}, {stamp: true[stamp] for stamp in both})
    iou = np.array(
        [[box_iou(moved_box(a.box, moved), b.box) for b in two.snapshot.objects] for a in one.snapshot.objects]
    )
    cells = [_cells(apply(moved, item.points_world)) for item in one.snapshot.objects]
    lying = [0] * len(cells)
    for keys in (_cells(item.points_world) for item in two.snapshot.objects):
        shares = [(round(float(are_near(own, keys).mean()), 2), -len(own), i) for i, own in enumerate(cells)]
        share, _, i = max(shares)
        lying[i] += share >= 0.5 and are_near(keys, cells[i]).mean() >= 0.2
    kept, back = (int((iou.max(axis=axis) >= 0.25).sum()) for axis in (1, 0))
    doubles = sum(max(count - 1, 0) for count in lying)
    return {"kept": kept, "given": iou.shape[0], "also_given": back, "found": iou.shape[1], "doubles": int(doubles)}


def _cells(points: NDArray[Any]) -> NDArray[np.int64]:
    return sorted_unique(keys_of_points(points.astype(np.float32), _CELL_M))


def _errors(poses: Poses, true: Poses) -> dict[str, Any]:
    found, there = (np.array([each[stamp_ns] for stamp_ns in sorted(poses)]) for each in (poses, true))
    error = trajectory_error(sorted(poses), found, sorted(poses), there)
    step, true_step = (compose(invert(each[0]), each[-1]) for each in (found, there))
    end_deg = float(np.degrees(rotation_angle_rad(true_step[:3, :3].T @ step[:3, :3])))
    drift = error.ate_m / error.way_m
    return {"ate_m": error.ate_m, "way_m": error.way_m, "drift": drift, "end_deg": end_deg, "poses": len(poses)}
