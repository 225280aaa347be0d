"""Poses: odometry against truth, corridors that do not tell how far one has come, where a camera sits, and fleets.

Real data is read from `../shared/data` beside the checkout, or `$HICKORY_DATA`; what is not there has no figure.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.evaluation.trajectory_error import TrajectoryError, trajectory_error
from hickory_stream.geometry.rigid import compose, invert, rotation_angle_rad
from hickory_stream.ports import Registered
from hickory_stream.poses.choose import make_odometry
from hickory_stream.poses.depth_scan import scan_of_depth
from hickory_stream.poses.hand_eye import HandEye
from hickory_stream.records import Scan
from hickory_stream.worlds.cache import cached_recording
from hickory_stream.worlds.corridor import CorridorConfig, corridor_scans
from hickory_stream.worlds.layouts import drawn_mounting
from hickory_stream.worlds.recording import make_recording
from hickory_stream.worlds.recording_config import RecordingConfig
from players import open_source
from players.logs.log_source import LogSource
from players.poses.extrinsics import estimated_extrinsics
from tools.benchmarks.drift_figures import drift_figures, registration_figures
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.fleet_figures import fleet_figures
from tools.benchmarks.loop_figures import loop_figures
from tools.benchmarks.loop_walks import walk_figures
from tools.benchmarks.mapped_squares import square_figures
from tools.benchmarks.pose_graph_figures import graph_figures
from tools.benchmarks.processes import ROOT

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from numpy.typing import NDArray

    from hickory_stream.poses.odometry_config import MethodName, Sensor

    Posed = tuple[Scan, NDArray[np.float64]]

_DEMO = ROOT / "recordings" / "demo.mcap"
_WORLDS = tuple(RecordingConfig(scene="apartment", seed=seed, seconds=40.0, rate_hz=5.0) for seed in (24, 30))
_ENDED = CorridorConfig()
"""A corridor of 30 m of which 18 m are walked: an end wall is 6 to 24 m away."""
_ENDLESS = CorridorConfig(length_m=60.0, margin_m=20.0, range_m=12.0)
_NUM_WALKS = 8
_ROOM = CorridorConfig(length_m=8.0, width_m=6.0, margin_m=1.0, way_m=6.0)


@dataclass(frozen=True, kw_only=True, slots=True)
class _Walked:
    """What an odometry made of a walk."""

    error: TrajectoryError
    end_error_m: float
    num_scans: int
    num_lost: int
    num_degenerate: int
    ms: float
    poses: NDArray[np.float64]


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run takes the demo for the worlds and shorter corridors, and no other method.

    `--only fleet` measures fleets alone, `--only graph` the pose graph, `--only loops` the search for loops, `--only
    walks` whole logs through rooms that look alike, `--only drift` logs whose odometry drifts, `--only squares` how
    well alignment knows how sure it is of parts of whole maps.
    """
    if options.only == ("drift",):
        return [*registration_figures(_DEMO), *drift_figures(options)]
    if options.only == ("fleet",):
        return fleet_figures(options)
    if options.only == ("loops",):
        return loop_figures(options)
    if options.only == ("squares",):
        return square_figures(options)
    if options.only == ("walks",):
        return walk_figures(options, num_walks=2 if options.quick else _NUM_WALKS)
    figures: list[Figure] = graph_figures(options)
    if options.only == ("graph",):
        return figures
    data = Path(os.environ.get("HICKORY_DATA") or ROOT.parent / "shared" / "data")
    if (data / "redkitchen").is_dir():
        kitchen = list(_frames(data / "redkitchen"))
        figures += _kitchen(kitchen, quick=options.quick)
    logs = [_DEMO] if options.quick else [cached_recording(config)[0] for config in _WORLDS]
    rooms = [_walk("depth", _frames(log)) for log in logs]
    worst = max(room.error.ate_m / room.error.way_m for room in rooms)
    told = f"of {len(rooms)} worlds, the worst; exact truth"
    figures.append(Figure(name="depth_way_fraction", value=worst, unit="", better="lower", of=told))
    if not options.quick:
        kiss = max(
            each.error.ate_m / each.error.way_m for each in (_walk("depth", _frames(log), "kiss-icp") for log in logs)
        )
        figures.append(Figure(name="depth_way_fraction_kiss_icp", value=kiss, unit="", better="lower", of=told))
    ms = float(np.mean([room.ms for room in rooms]))
    figures.append(
        Figure(name="depth_odometry_ms", value=ms, unit="ms", better="lower", of="processor time of a depth frame")
    )
    figures += registration_figures(logs[0])
    again = _walk("depth", _frames(logs[0]))
    is_same = float(again.poses.tobytes() == rooms[0].poses.tobytes())
    figures.append(Figure(name="poses_identical", value=is_same, unit="", better="higher"))
    figures += _corridors(rooms, quick=options.quick)
    if (data / "kitti_lidar").is_dir():
        figures += _street(data / "kitti_lidar")
    figures += [*loop_figures(options), *fleet_figures(options)]
    return (
        figures
        if options.quick
        else [*figures, *_mountings((7, 8, 9)), *walk_figures(options, _NUM_WALKS), *drift_figures(options)]
    )


def _kitchen(kitchen: list[Posed], *, quick: bool) -> list[Figure]:
    own = _walk("depth", kitchen)
    found = [
        Figure(
            name="depth_odometry_ate_m", value=own.error.ate_m, unit="m", better="lower",
            of=f"redkitchen, {own.num_scans} frames, {own.error.way_m:.1f} m",
        ),
    ]  # fmt: skip
    if not quick:
        kiss = _walk("depth", kitchen, "kiss-icp")
        found.append(Figure(name="depth_kiss_icp_ate_m", value=kiss.error.ate_m, unit="m", better="lower"))
    return found


def _corridors(rooms: list[_Walked], *, quick: bool) -> list[Figure]:
    """Return what is made of corridors, and how many scans of rooms are called degenerate by mistake."""
    short = {"way_m": 6.0, "columns": 360} if quick else {}
    ended = corridor_scans(replace(_ENDED, **short), 1)  # type: ignore[arg-type]
    endless = corridor_scans(replace(_ENDLESS, **short), 1)  # type: ignore[arg-type]
    own, blind = _walk("lidar", ended), _walk("lidar", endless)
    led = _walk("lidar", endless, is_led=True)
    rooms = [*rooms, _walk("lidar", corridor_scans(_ROOM, 1))]
    false = sum(room.num_degenerate for room in rooms) / sum(room.num_scans for room in rooms)
    found = [
        Figure(name="corridor_end_error_m", value=own.end_error_m, unit="m", better="lower", of="its ends in reach"),
        Figure(
            name="corridor_declared_fraction", value=blind.num_degenerate / blind.num_scans, unit="", better="higher",
            of="scans of a corridor without ends",
        ),
        Figure(
            name="corridor_led_end_error_m", value=led.end_error_m, unit="m", better="lower",
            of="without ends, the motion given",
        ),
        Figure(name="degenerate_false_fraction", value=false, unit="", better="lower", of="scans of rooms"),
    ]  # fmt: skip
    if not quick:
        kiss = _walk("lidar", ended, "kiss-icp")
        found.append(Figure(name="corridor_kiss_icp_end_error_m", value=kiss.end_error_m, unit="m", better="lower"))
    return found


def _street(folder: Path) -> list[Figure]:
    """Return how many sweeps of a street are registered, and how evenly: the car goes 0.81 m with each at the end."""
    odometry = make_odometry("lidar")
    found = [
        odometry.register(Scan(stamp_ns=i * 100_000_000, frame="lidar", points=_points_of(file)))
        for i, file in enumerate(sorted(folder.glob("*.pcd")))
    ]
    poses = [each.start_from_sensor for each in found if isinstance(each, Registered)]
    steps = np.array([np.linalg.norm(compose(invert(a), b)[:3, 3]) for a, b in pairwise(poses)])
    jerk = float(np.abs(np.diff(steps)).max())
    return [
        Figure(name="street_registered_fraction", value=len(poses) / len(found), unit="", better="higher"),
        Figure(name="street_step_change_m", value=jerk, unit="m", better="lower", of="from sweep to sweep, the most"),
    ]


def _mountings(seeds: Iterable[int]) -> list[Figure]:
    """Return how far the camera of a B2 is from where its motion says, the worst of some; what is open is left out."""
    moved, turned, num_open = [], [], 0
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            config = RecordingConfig(
                seed=seed, seconds=30.0, width=320, height=180, layout="nus_clb", camera_offset=True
            )
            make_recording(config, Path(folder), "b2", caster=None)
            source = open_source(Path(folder) / "b2")
            assert isinstance(source, LogSource)
            found = estimated_extrinsics(source)
        if not isinstance(found, HandEye):
            continue
        off = found.body_from_camera[:3, 3] - drawn_mounting(seed)[:3, 3]
        is_open = np.isin(["forward", "left", "up"], found.open_names())
        num_open += int(is_open.sum())
        moved.append(float(np.abs(off[~is_open]).max(initial=0.0)))
        turned.append(np.degrees(rotation_angle_rad(found.body_from_camera[:3, :3] @ drawn_mounting(seed)[:3, :3].T)))
    if not moved:
        return []
    said = f"{len(moved)} mountings, the worst axis"
    return [
        Figure(
            name="hand_eye_error_m", value=max(moved), unit="m", better="lower", of=said,
            left_out=f"{num_open} axes said to be open",
        ),
        Figure(name="hand_eye_error_deg", value=float(max(turned)), unit="deg", better="lower", of=said),
    ]  # fmt: skip


def _frames(log: Path) -> Iterator[Posed]:
    """Yield the depth frames of a log as scans, with the poses of the log."""
    source = open_source(log)
    for raw in source.frames():
        yield scan_of_depth(raw.decode()), raw.world_from_camera
    source.close()


def _walk(sensor: Sensor, walk: Iterable[Posed], method: MethodName | None = None, *, is_led: bool = False) -> _Walked:
    """Return what an odometry makes of scans with true poses; `is_led`: the true motion predicts."""
    odometry = make_odometry(sensor, method)
    stamps_ns: list[int] = []
    poses: list[NDArray[np.float64]] = []
    true: list[NDArray[np.float64]] = []
    num_scans, num_degenerate, spent_s = 0, 0, 0.0
    for scan, world_from_sensor in walk:
        step = compose(invert(true[-1]), world_from_sensor) if is_led and true else None
        started_s = time.process_time()
        found = odometry.register(scan, step)
        spent_s += time.process_time() - started_s
        num_scans += 1
        if isinstance(found, Registered):
            num_degenerate += len(found.degenerate) > 0
            stamps_ns.append(scan.stamp_ns)
            poses.append(found.start_from_sensor)
            true.append(world_from_sensor)
    estimated, truth = np.array(poses), np.array(true)
    moved = compose(invert(truth[0]), truth[-1])
    return _Walked(
        error=trajectory_error(stamps_ns, estimated, stamps_ns, truth),
        end_error_m=float(np.linalg.norm(estimated[-1][:3, 3] - moved[:3, 3])),
        num_scans=num_scans,
        num_lost=num_scans - len(poses),
        num_degenerate=num_degenerate,
        ms=1e3 * spent_s / num_scans,
        poses=estimated,
    )


def _points_of(file: Path) -> NDArray[np.float32]:
    """Return the points (N, 3) of a binary PCD whose fields are four floats."""
    data = file.read_bytes()
    start = data.index(b"DATA binary\n") + len(b"DATA binary\n")
    count = next(int(line.split()[1]) for line in data[:start].decode().splitlines() if line.startswith("POINTS"))
    rows = np.frombuffer(data, np.float32, 4 * count, start).reshape(count, 4)
    return np.ascontiguousarray(rows[:, :3])
