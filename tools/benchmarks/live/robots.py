"""Robots over every live route: from a fake robot to the ledger and to the map, on the loopback address."""
# Transport reads 1280x720 at 30 Hz without mapping. Map: the embedded recording as a robot that goes away once. Storm:
# losses, jitter, disconnections and a restart. Goals are answered by paths. Safety: when a robot keeps off what it
# sees.

import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hickory_stream.base.config_text import read_config
from hickory_stream.config import MapperConfig
from hickory_stream.engine.mapper import Mapper
from hickory_stream.evaluation.match import STRICT_IOU, match_boxes
from hickory_stream.evaluation.truth import Truth, frame_at, instances_of, load_truth
from hickory_stream.geometry.camera import backproject
from hickory_stream.geometry.rigid import apply
from hickory_stream.geometry.superquadric import Superquadrics, implicit_value, volumes_m3, world_bounds
from hickory_stream.geometry.voxels import cells_of_keys, contains, keys_of_points, sorted_unique, union
from hickory_stream.map_folder.saved_map import open_map
from hickory_stream.navigation.stand_ins import SeenSurface, early_obstacles
from hickory_stream.records import FrameReport, MapSnapshot
from hickory_stream.testing import RememberingSink
from players import make_source_note, open_from_note
from players.options import SourceOptions
from players.playback import PlaybackClock
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import DEMO, NO_SHAPES, ROOT, overridden, play
from tools.benchmarks.live.camera_log import write_720p

_ROUTES = ("zenoh-bridge", "rmw-zenoh", "foxglove", "mcap")
_EXTRA_ROUTES = {"dds": "cyclonedds"}
"""Routes that need a package of an extra: measured where it is installed, and not when quick."""
_SCHEMES = {"zenoh-bridge": "zenoh", "rmw-zenoh": "zenoh", "foxglove": "foxglove"}
_TIMEOUT_S = 900.0
_LOSS = 0.1
_STORM = ("--loss", "0.1", "--jitter", "150", "--delay", "40", "--bandwidth", "10", "--clock-offset", "-300")


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """The size of a run: loops of a log over each route, mapped seconds, and the options of the robot."""

    # `at_once` routes are measured at the same time. Goals are requested in the run that is mapped and recorded, or in
    # one of their own (`has_own_goals`), so that latencies are those of mapping alone.

    log_s: float = 2.0
    loops: int = 30
    at_once: int = 1
    extras: bool = True
    has_own_goals: bool = True
    map_s: float = 20.0
    away: tuple[str, ...] = ("--seconds", "15", "--loop", "3", "--disconnect", "8:30")
    storm: tuple[str, ...] = (*_STORM, *"--disconnect 40:60 --disconnect 150:5 --restart 200 --loop 15".split())
    map_options: tuple[str, ...] = ()
    mapped_720p_s: float = 20.0
    safety_s: float = 20.0

    @property
    def goals(self) -> list[str]:
        """The options with which a robot requests paths while the map is made; also goals without a path."""
        return [word for at in np.arange(2.0, self.map_s, 0.25).tolist() for word in ("--goal", f"{at}:0.5,0.5")]


_QUICK = Sample(
    log_s=1.0, loops=3, at_once=2, extras=False, has_own_goals=False, map_s=4.5,
    away=("--seconds", "3.5", "--disconnect", "1.5:1"),
    storm=(*_STORM, *"--disconnect 1.5:1 --restart 3 --seconds 4.5".split()), map_options=("--no-shapes",),
    mapped_720p_s=0.0, safety_s=2.0,
)  # fmt: skip


def measure(options: Options) -> list[Figure]:
    sample = _QUICK if options.quick else Sample()
    with tempfile.TemporaryDirectory(prefix="hickory-live-") as name:
        folder = Path(name)
        figures = _transport(sample, options.seed, folder)
        figures += _map(sample, folder)
        if sample.has_own_goals:
            to = ("--out", folder / "goals", "--publish", *sample.map_options)
            sent, _ = _run("zenoh-bridge", [DEMO], folder, "--seconds", str(sample.map_s), *sample.goals, to=to)
            figures += _published(sample, sent)
        figures += _storm(sample, options.seed, folder)
        figures += _safety(sample, folder)
    return figures


def _transport(sample: Sample, seed: int, folder: Path) -> list[Figure]:
    log = write_720p(DEMO, folder / "720p.mcap", seconds=sample.log_s)
    extra = [via for via, needed in _EXTRA_ROUTES.items() if sample.extras and find_spec(needed) is not None]
    routes = (*_ROUTES, *extra)

    def measured(via: str) -> tuple[dict[str, Any], dict[str, Any]]:
        return _run(via, [log], folder, "--loop", str(sample.loops), "--seed", str(seed))

    with ThreadPoolExecutor(sample.at_once) as pool:
        found = list(pool.map(measured, routes))
    unaccounted = sum(_unaccounted(sent, came) for sent, came in found)
    lost = [1.0 - sum(came["totals"].values()) / sum(sent["sent"].values()) for sent, came in found]
    shares = {via.replace("-", "_"): came["cpu_share"] for via, (_, came) in zip(routes, found, strict=True)}
    of = "1280x720 JPEG and raw 16-bit depth at 30 Hz, not mapped; the worst route"
    sent, came = _run("rmw-zenoh", [DEMO], folder, "--loss", str(_LOSS), "--seconds", "4", "--seed", str(seed))
    injected = sum(number for reasons in sent["lost"].values() for number in reasons.values())
    noticed = sum(came["lost"].values())
    injected_loss = injected / (injected + sum(sent["sent"].values()))
    found_loss = noticed / (noticed + sum(came["totals"].values()))
    return [
        figure("live_routes", len(routes), "routes", "higher", ", ".join(routes)),
        figure("live_unaccounted_messages", unaccounted + _unaccounted(sent, came), "messages", "lower"),
        figure("live_lost_fraction", max(lost), "share", "lower", "no loss injected; the worst route"),
        figure("live_transport_core_share", max(shares.values()), "cores", "lower", of),
        *(figure(f"live_transport_core_share_{via}", value, "cores", "lower") for via, value in shares.items()),
        figure("live_injected_loss", injected_loss, "share", "same", "rmw-zenoh"),
        figure("live_found_loss", found_loss, "share", "same", "by its numbers"),
    ]


def _map(sample: Sample, folder: Path) -> list[Figure]:
    out, record = folder / "live", folder / "session.mcap"
    goals = () if sample.has_own_goals else sample.goals
    to = ("--out", out, "--record", record, *sample.map_options, *(("--publish",) if goals else ()))
    sent, came = _run("zenoh-bridge", [DEMO], folder, "--seconds", str(sample.map_s), *goals, to=to)
    again = folder / "again"
    play(record, again, *(overridden(NO_SHAPES) if sample.map_options else ()))
    live, recorded = ([t.box for t in open_map(path).snapshot.objects] for path in (out, again))
    recall = len(match_boxes(recorded, live, STRICT_IOU)) / max(len(recorded), 1)
    of = f"from the last image of a keyframe to its snapshot, 640x360 at 6 Hz, {len(came['latency_s'])} keyframes"
    of_wait = "from a frame's last image to the frame, while the map is made"
    of_recall = f"{len(recorded)} objects of the recording's map in the live one"
    figures = [
        figure("live_latency_p95_ms", 1e3 * _percentile(came["latency_s"]), "ms", "lower", of),
        figure("live_pairing_p95_ms", 1e3 * _percentile(came["wait_s"]), "ms", "lower", of_wait),
        figure("live_map_unaccounted", _unaccounted(sent, came), "messages", "lower"),
        figure("live_vs_recorded_recall_50", recall, "share", "higher", of_recall),
    ]
    figures += _published(sample, sent) if goals else []
    if sample.mapped_720p_s:
        large = write_720p(DEMO, folder / "mapped.mcap", seconds=sample.mapped_720p_s, repeats=False)
        _, slow = _run("zenoh-bridge", [large], folder, to=("--out", folder / "large"))
        of = f"the same at 1280x720, {len(slow['latency_s'])} keyframes"
        figures.append(figure("live_latency_720p_p95_ms", 1e3 * _percentile(slow["latency_s"]), "ms", "lower", of))
    away, back = _run("zenoh-bridge", [DEMO], folder, *sample.away)
    gaps_ns = np.diff(back["stamps_ns"])
    if len(gaps_ns) and away["returned_s"]:
        # The first frame after the gap in the stamps that the absence has left.
        first_s = back["came_s"][int(gaps_ns.argmax()) + 1]
        of = f"from the robot's return to the first frame; away {sample.away[-1]} (at:for)"
        figures.append(figure("reconnect_s", first_s - away["returned_s"][0], "s", "lower", of))
    return figures


def _published(sample: Sample, sent: dict[str, Any]) -> list[Figure]:
    trips_s, heard = sent["round_trips_s"], sent["heard"]
    of = f"p95 of {len(trips_s)} of {len(sample.goals) // 2} goals, while the map is made"
    published = figure("published_messages", sum(heard.values()), "messages", "higher", ", ".join(sorted(heard)))
    return [*_percentiles("plan_round_trip_ms", [1e3 * s for s in trips_s], "ms", of), published]


def _percentiles(name: str, values: list[float], unit: str, of: str) -> list[Figure]:
    return [figure(name, _percentile(values), unit, "lower", of)] if values else []


def _storm(sample: Sample, seed: int, folder: Path) -> list[Figure]:
    try:
        to = ("--out", folder / "storm", *sample.map_options)
        sent, came = _run("rmw-zenoh", [DEMO], folder, *sample.storm, "--seed", str(seed), to=to)
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return [figure("storm_crashes", 1, "crashes", "lower")]
    of = "loss, jitter, delay, 10 Mbit/s, disconnections, a restart at zero, a clock that is 5 min off"
    return [
        figure("storm_crashes", 0, "crashes", "lower", of),
        figure("storm_unaccounted", _unaccounted(sent, came), "messages", "lower"),
        figure("storm_peak_mb", came["peak_mb"], "MB", "lower"),
    ]


def _safety(sample: Sample, folder: Path) -> list[Figure]:
    found = early_safety(DEMO, folder / "safety", seconds=sample.safety_s, has_shapes=not sample.map_options)
    things, never = f"{len(found.shown_s)} things within 3 m", len(found.shown_s) - len(found.safe_s)
    safe_s, safe_log_s = _percentile([*found.safe_s.values()]), _percentile([*found.safe_log_s.values()])
    of_log, of_never = "the same by the stamps: 0 is the first keyframe that shows a thing", f"{sample.safety_s:g} s"
    contained, avoided = _percentile(found.contained, 5), _percentile(found.avoided, 5)
    return [
        figure("time_to_safe_shape_s", safe_s, "s", "lower", f"p95 of {things}"),
        figure("time_to_safe_shape_log_s", safe_log_s, "s", "lower", of_log),
        figure("never_safe_things", never, "things", "lower", f"of {things}, in {of_never}"),
        figure("stand_in_contained_p5", contained, "share", "higher", "of the surface seen so far"),
        figure("avoided_p5", avoided, "share", "higher", "the same with occupied space"),
        *_percentiles("stand_in_volume_ratio_p95", found.volumes, "ratio", "to the final layer 4"),
    ]


def _run(
    via: str, logs: list[Path], folder: Path, *faults: str, to: tuple[str | Path, ...] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    if via == "dds":
        # Ports are those of the domain; runs at the same time are not to hear one another.
        domain = 1 + os.getpid() % 100
        where, uri = ("--domain", str(domain)), f"dds://{domain}"
    else:
        place = str(folder / "pipe") if via == "mcap" else f"127.0.0.1:{_free_port()}"
        where, uri = ("--listen", place), f"mcap:{place}" if via == "mcap" else f"{_SCHEMES[via]}://{place}"
        if via == "mcap" and not Path(place).exists():
            os.mkfifo(place)
    robot = [sys.executable, "-m", "tools.robot.command", *map(str, logs), "--via", via, *where, "--wait", *faults]
    receiver = [sys.executable, "-m", "tools.benchmarks.live.receiver", uri, *map(str, to)]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": ROOT}
    with (
        subprocess.Popen(robot, **pipes) as sending,
        subprocess.Popen(receiver, stdin=subprocess.PIPE, **pipes) as receiving,
    ):
        try:
            sent, robot_error = sending.communicate(timeout=_TIMEOUT_S)
            came, receiver_error = receiving.communicate(timeout=_TIMEOUT_S)
        finally:
            sending.kill()
            receiving.kill()
    if sending.returncode or receiving.returncode:
        raise RuntimeError(f"{via}: the robot said {robot_error[-500:]!r}, the receiver {receiver_error[-500:]!r}")
    return json.loads(sent), json.loads(came.splitlines()[-1])


def _unaccounted(sent: dict[str, Any], came: dict[str, Any]) -> int:
    missing = [abs(number - came["totals"].get(topic, 0)) for topic, number in sent["sent"].items()]
    return sum(missing) + abs(came["difference"])


def _percentile(values: Sequence[float], percent: float = 95.0) -> float:
    return float(np.percentile(values, percent)) if values else 0.0


def _free_port() -> int:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return int(server.getsockname()[1])


# How soon a robot keeps off the things that it sees: a live run of the embedded recording against its truth.
# Counted from the first keyframe with a hundredth of a steradian of a thing within 3 m, to the first snapshot whose
# collision bodies hold 0.98 of the surface seen by then.
CONTAINED = 0.98
_NEAR_M = 3.0
_LEAST_SR = 0.01
_POINTS_M = 0.01


@dataclass(slots=True)
class Safety:
    """Of each true thing: when it was shown and first avoided (seconds after that), and its share in the bodies."""

    # `safe_log_s`: by stamps, without computing time. `contained`: shares of seen surface in stand-ins and layers 4;
    # `avoided`: with occupied space. `volumes`: stand-ins over final layers 4.

    shown_s: dict[int, float] = field(default_factory=dict)
    safe_s: dict[int, float] = field(default_factory=dict)
    safe_log_s: dict[int, float] = field(default_factory=dict)
    contained: list[float] = field(default_factory=list)
    avoided: list[float] = field(default_factory=list)
    volumes: list[float] = field(default_factory=list)


class Evaluation:
    """Compares the bodies that a robot avoids after each keyframe with the truth."""

    def __init__(self, truth: Truth) -> None:
        self.found = Safety()
        self._truth = truth
        self._stamps = np.array([frame.stamp_ns for frame in truth.frames])
        self._seen = SeenSurface()
        self._surface: dict[int, NDArray[np.int64]] = {}
        self._stand_ins: defaultdict[int, list[float]] = defaultdict(list)

    def add(self, report: FrameReport) -> None:
        at = frame_at(self._stamps, report.stamp_ns)
        if at is None:
            return
        assert report.frame is not None and report.space is not None and report.snapshot is not None
        self._seen.add(report.space, report.snapshot)
        instances = instances_of(self._truth, self._truth.frames[at])
        depth = report.frame.depth_m
        points = apply(report.world_from_camera, backproject(depth, report.camera))
        is_near = np.isfinite(depth) & (depth < _NEAR_M)
        per_pixel_sr = 1.0 / (report.camera.fx * report.camera.fy)
        for item in self._truth.objects:
            # Beside an edge the depth of a pixel may be another thing's.
            inner = cv2.erode((instances == item.id).astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)
            shown = is_near & inner
            if shown.sum() * per_pixel_sr >= _LEAST_SR:
                self.found.shown_s.setdefault(item.id, report.stamp_ns / 1e9)
            keys = sorted_unique(keys_of_points(points[shown], _POINTS_M))
            self._surface[item.id] = np.union1d(self._surface.get(item.id, np.empty(0, np.int64)), keys)
        self._compare(report, report.snapshot)

    def end(self, last: MapSnapshot) -> None:
        """Compare the stand-ins' volumes with those of the final layers 4."""
        for obstacle in early_obstacles(last.objects):
            if not obstacle.is_observed_only:
                final_m3 = float(volumes_m3(obstacle.body).sum())
                self.found.volumes += [volume / final_m3 for volume in self._stand_ins[obstacle.id]]

    def _compare(self, report: FrameReport, snapshot: MapSnapshot) -> None:
        obstacles = early_obstacles(snapshot.objects)
        for obstacle in obstacles:
            if obstacle.is_observed_only:
                self._stand_ins[obstacle.id].append(float(volumes_m3(obstacle.body).sum()))
        latency_s = dict(report.metrics)["time/latency"]
        space = snapshot.submaps[-1].observed_space
        occupied = union(self._seen.keys(), space.structure)
        for item_id, shown_s in self.found.shown_s.items():
            points = (cells_of_keys(self._surface[item_id]) + 0.5) * _POINTS_M
            is_held = np.zeros(len(points), bool)
            for obstacle in obstacles:
                is_held |= _inside(obstacle.body, points)
            is_avoided = is_held | contains(occupied, keys_of_points(points, space.voxel_m))
            self.found.contained.append(float(is_held.mean()))
            self.found.avoided.append(float(is_avoided.mean()))
            if is_avoided.mean() >= CONTAINED:
                waited_s = report.stamp_ns / 1e9 - shown_s
                self.found.safe_log_s.setdefault(item_id, waited_s)
                self.found.safe_s.setdefault(item_id, waited_s + latency_s)


def early_safety(log: Path, out: Path, *, seconds: float, has_shapes: bool = True) -> Safety:
    """Map the beginning of a log live, and return how soon and how well its things were avoided."""
    # A live run does not wait, and its evaluation takes longer than mapping.
    collected = RememberingSink()
    config = read_config(MapperConfig, None, () if has_shapes else (NO_SHAPES,))
    source = open_from_note(
        make_source_note([str(log)], SourceOptions(), end_s=seconds), PlaybackClock(1.0), config.keyframes
    )

    async def run() -> None:
        async with Mapper(config, out=out, overwrite=True) as mapper:
            async for _ in mapper.run(source, sinks=lambda _folder: [(collected, True)], mode="live"):
                pass

    asyncio.run(run())
    source.close()
    evaluation = Evaluation(load_truth(log.with_suffix(".truth")))
    mapped = [report for report in collected.reports if report.snapshot is not None]
    for report in mapped:
        if report.frame is not None and report.space is not None:
            evaluation.add(report)
    if mapped and (last := mapped[-1].snapshot) is not None:
        evaluation.end(last)
    return evaluation.found


def _inside(body: Superquadrics, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    is_inside = np.zeros(len(points), bool)
    for i, (low, high) in enumerate(world_bounds(body)):
        near = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
        is_inside[near] |= implicit_value(body, i, points[near]) <= 1.0
    return is_inside
