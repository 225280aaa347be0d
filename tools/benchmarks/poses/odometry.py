"""Poses: odometry against truth, corridors without features along them, extrinsics of cameras, and fleets."""
# Real data is read from `../shared/data` beside the checkout, or `$HICKORY_DATA`; without it there is no figure of it.

import tempfile
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hickory_stream.geometry.rigid import compose, invert, rotation_angle_rad
from hickory_stream.ports import Registered
from hickory_stream.poses.choose import make_odometry
from hickory_stream.poses.hand_eye import HandEye
from hickory_stream.poses.odometry_config import MethodName
from hickory_stream.records import Scan
from hickory_stream.worlds.recording import make_recording
from players import open_source
from players.logs.log_source import LogSource
from players.poses.extrinsics import estimated_extrinsics
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import DEMO
from tools.benchmarks.poses.drift import drift_figures, registration_figures
from tools.benchmarks.poses.fleets import campus_figures, fleet_figures
from tools.benchmarks.poses.loop_walks import walk_figures
from tools.benchmarks.poses.loops import loop_figures
from tools.benchmarks.poses.pose_graphs import graph_figures, public_figures
from tools.benchmarks.poses.real import data_folder, estimated, real_figures
from tools.worlds.cache import cached_recording
from tools.worlds.corridor import CorridorConfig, corridor_scans
from tools.worlds.layouts import drawn_mounting
from tools.worlds.recording_config import RecordingConfig

Posed = tuple[Scan, NDArray[np.float64]]

_WORLDS = tuple(RecordingConfig(scene="apartment", seed=seed, seconds=40.0, rate_hz=5.0) for seed in (24, 30))
_ENDED = CorridorConfig()
"""A corridor of 30 m of which 18 m are walked: an end wall is 6 to 24 m away."""
_ENDLESS = CorridorConfig(length_m=60.0, margin_m=20.0, range_m=12.0)
_ROOM = CorridorConfig(length_m=8.0, width_m=6.0, margin_m=1.0, way_m=6.0)
_EXTRINSICS_SEEDS = (7, 8, 9)
_PARTS: dict[str, Callable[[Options], list[Figure]]] = {
    "campus": campus_figures, "drift": lambda options: [*registration_figures(DEMO), *drift_figures(options)],
    "fleet": fleet_figures,
    "graph": lambda options: [*graph_figures(options), *public_figures(data_folder() / "graphs", options)],
    "loops": loop_figures, "walks": walk_figures, "real": real_figures,
}  # fmt: skip


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run takes the demo for the worlds and shorter corridors, and no other method."""
    # `--only` measures one part: `fleet`, the pose `graph`, the search for `loops`, `walks` through rooms that look
    # alike, logs whose odometry has `drift`, `real` walks, or pairs of walks of a `campus`.
    if len(options.only) == 1 and options.only[0] in _PARTS:
        return _PARTS[options.only[0]](options)
    quick = options.quick
    figures = [*graph_figures(options), *real_figures(options)]
    logs = [DEMO] if quick else [cached_recording(config)[0] for config in _WORLDS]
    rooms = [estimated(log) for log in logs]
    of = f"of {len(rooms)} worlds, the worst; exact truth"
    figures.append(figure("depth_way_fraction", max(room["drift"] for room in rooms), "", "lower", of))
    if not quick:
        kiss = max(estimated(log, "kiss-icp")["drift"] for log in logs)
        figures.append(figure("depth_way_fraction_kiss_icp", kiss, "", "lower", of))
    ms, of = np.mean([room["ms"] for room in rooms]), "processor time of a depth frame, with its decoding"
    figures.append(figure("depth_odometry_ms", ms, "ms", "lower", of))
    figures += registration_figures(logs[0])
    figures.append(figure("poses_identical", estimated(logs[0])["digest"] == rooms[0]["digest"]))
    figures += _corridors(rooms, quick=quick)
    figures += [*loop_figures(options), *fleet_figures(options)]
    return (
        figures
        if quick
        else [*figures, *_extrinsics(), *walk_figures(options), *drift_figures(options), *campus_figures(options)]
    )


def _corridors(rooms: list[dict[str, Any]], *, quick: bool) -> list[Figure]:
    short: dict[str, Any] = {"way_m": 6.0, "columns": 360} if quick else {}
    ended, endless = (corridor_scans(replace(config, **short), 1) for config in (_ENDED, _ENDLESS))
    own, blind, led = _walk(ended), _walk(endless), _walk(endless, is_led=True)
    room = _walk(corridor_scans(_ROOM, 1))
    num_degenerate = room.num_degenerate + sum(each["degenerate"] for each in rooms)
    false = num_degenerate / (room.num_scans + sum(each["frames"] for each in rooms))
    declared, of = blind.num_degenerate / blind.num_scans, "scans of a corridor without ends"
    figures = [
        figure("corridor_end_error_m", own.end_error_m, "m", "lower", "its ends in reach"),
        figure("corridor_declared_fraction", declared, "", "higher", of),
        figure("corridor_led_end_error_m", led.end_error_m, "m", "lower", "without ends, the motion given"),
        figure("degenerate_false_fraction", false, "", "lower", "scans of rooms"),
    ]
    if not quick:
        kiss = _walk(ended, "kiss-icp")
        figures.append(figure("corridor_kiss_icp_end_error_m", kiss.end_error_m, "m", "lower"))
    return figures


def _extrinsics() -> list[Figure]:
    moved, turned, num_open = [], [], 0
    for seed in _EXTRINSICS_SEEDS:
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
    of, left_out = f"{len(moved)} mountings, the worst axis", f"{num_open} axes said to be open"
    return [
        figure("hand_eye_error_m", max(moved), "m", "lower", of, left_out=left_out),
        figure("hand_eye_error_deg", max(turned), "deg", "lower", of),
    ]


def _walk(walk: Iterable[Posed], method: MethodName | None = None, *, is_led: bool = False) -> SimpleNamespace:
    odometry, before, start = make_odometry("lidar", method), None, None
    num_scans = num_degenerate = 0
    for scan, world_from_sensor in walk:
        step = compose(invert(before), world_from_sensor) if is_led and before is not None else None
        found = odometry.register(scan, step)
        num_scans += 1
        if isinstance(found, Registered):
            num_degenerate += len(found.degenerate) > 0
            before, last = world_from_sensor, found.start_from_sensor
            start = start if start is not None else before
    moved = compose(invert(start), before)
    end_error_m = float(np.linalg.norm(last[:3, 3] - moved[:3, 3]))
    return SimpleNamespace(end_error_m=end_error_m, num_scans=num_scans, num_degenerate=num_degenerate)
