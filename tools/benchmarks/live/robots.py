"""Live: every route from a fake robot to the ledger and to the map, on the loopback address.

Five parts. Transport: 1280x720 JPEG colour and raw 16-bit depth at 30 Hz over each route, read and paired but not
mapped. Map: the embedded recording as a robot, mapped, recorded, and compared with the map of the recording; the robot
goes away once. Storm: losses, jitter, disconnections and a restart at once, mapped. Goals of the robot are answered
with paths. Safety: how soon a robot keeps off what it sees.
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from hickory_stream.engine.saved_map import open_map
from hickory_stream.evaluation.match import STRICT_IOU, match_boxes
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT, play
from tools.benchmarks.live.camera_log import write_720p
from tools.benchmarks.live.safety import early_safety

_DEMO = ROOT / "recordings" / "demo.mcap"
_ROUTES = ("zenoh-bridge", "rmw-zenoh", "foxglove", "mcap")
_EXTRA_ROUTES = {"dds": "cyclonedds"}
"""Routes that need a package of an extra: measured where it is installed, and not when quick."""
_SCHEMES = {"zenoh-bridge": "zenoh", "rmw-zenoh": "zenoh", "foxglove": "foxglove"}
_TIMEOUT_S = 900.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """How much is measured: loops of a log over each route, seconds that are mapped; what the robot is told.

    `at_once` routes are measured at the same time. Goals are asked for in the run that is mapped and recorded, or in
    one of their own (`has_own_goals`), so that latencies are those of mapping alone.
    """

    log_s: float
    loops: int
    at_once: int
    extras: bool
    has_own_goals: bool
    map_s: float
    away: tuple[str, ...]
    storm: tuple[str, ...]
    map_options: tuple[str, ...]
    mapped_720p_s: float
    safety_s: float


_STORM = ("--loss", "0.1", "--jitter", "150", "--delay", "40", "--bandwidth", "10", "--clock-offset", "-300")
_FULL = Sample(
    log_s=2.0,
    loops=30,
    at_once=1,
    extras=True,
    has_own_goals=True,
    map_s=20.0,
    away=("--seconds", "15", "--loop", "3", "--disconnect", "8:30"),
    storm=(*_STORM, "--disconnect", "40:60", "--disconnect", "150:5", "--restart", "200", "--loop", "15"),
    map_options=(),
    mapped_720p_s=8.0,
    safety_s=20.0,
)
_QUICK = Sample(
    log_s=1.0,
    loops=3,
    at_once=2,
    extras=False,
    has_own_goals=False,
    map_s=4.5,
    away=("--seconds", "3.5", "--disconnect", "1.5:1"),
    storm=(*_STORM, "--disconnect", "1.5:1", "--restart", "3", "--seconds", "4.5"),
    map_options=("--no-shapes",),
    mapped_720p_s=0.0,
    safety_s=2.0,
)


def measure(options: Options) -> list[Figure]:
    """Measure all parts."""
    sample = _QUICK if options.quick else _FULL
    with tempfile.TemporaryDirectory(prefix="hickory-live-") as name:
        folder = Path(name)
        figures = _transport(sample, options.seed, folder)
        figures += _map(sample, options.seed, folder)
        if sample.has_own_goals:
            to = ("--out", folder / "told", "--publish", *sample.map_options)
            seconds = ("--seconds", str(sample.map_s))
            sent, _ = _run("zenoh-bridge", [_DEMO], folder, *seconds, *_goals(sample), to=to)
            figures += _published(sample, sent)
        figures += _storm(sample, options.seed, folder)
        figures += _safety(sample, folder)
    return figures


def _transport(sample: Sample, seed: int, folder: Path) -> list[Figure]:
    log = write_720p(_DEMO, folder / "720p.mcap", seconds=sample.log_s)
    unaccounted, shares, robots, lost, waits = 0, [], [], [], []
    figures: list[Figure] = []
    extra = [via for via, needed in _EXTRA_ROUTES.items() if sample.extras and find_spec(needed) is not None]
    routes = (*_ROUTES, *extra)

    def measured(via: str) -> tuple[dict[str, Any], dict[str, Any]]:
        return _run(via, [log], folder, "--loop", str(sample.loops), "--seed", str(seed))

    with ThreadPoolExecutor(sample.at_once) as pool:
        found_by_route = list(pool.map(measured, routes))
    for via, (sent, came) in zip(routes, found_by_route, strict=True):
        unaccounted += _unaccounted(sent, came)
        lost.append(1.0 - sum(came["totals"].values()) / sum(sent["sent"].values()))
        robots.append(sent["cpu_s"] / sent["wall_s"])
        waits += came["wait_s"]
        shares.append(came["cpu_share"])
        name = f"live_transport_core_share_{via.replace('-', '_')}"
        figures.append(figure(name, came["cpu_share"], "cores", "lower"))
    of = "1280x720 JPEG and raw 16-bit depth at 30 Hz, not mapped; the worst route"
    injected = 0.1
    sent, came = _run("rmw-zenoh", [_DEMO], folder, "--loss", str(injected), "--seconds", "4", "--seed", str(seed))
    gone = sum(number for reasons in sent["lost"].values() for number in reasons.values())
    found = sum(came["lost"].values())
    return [
        figure("live_routes", len(routes), "routes", "higher", ", ".join(routes)),
        figure("live_unaccounted_messages", unaccounted + _unaccounted(sent, came), "messages", "lower"),
        figure("live_lost_fraction", max(lost), "share", "lower", "no loss injected; the worst route"),
        figure("live_transport_core_share", max(shares), "cores", "lower", of),
        *figures,
        figure("live_robot_core_share", max(robots), "cores", "same", "the fake robot's own"),
        figure("live_pairing_p95_ms", 1e3 * _p95(waits), "ms", "lower", "from a frame's last image to the frame"),
        figure("live_injected_loss", gone / (gone + sum(sent["sent"].values())), "share", "same", "rmw-zenoh"),
        figure("live_found_loss", found / (found + sum(came["totals"].values())), "share", "same", "by its numbers"),
    ]


def _map(sample: Sample, seed: int, folder: Path) -> list[Figure]:
    out, record = folder / "live", folder / "session.mcap"
    asked = () if sample.has_own_goals else _goals(sample)
    to = ("--out", out, "--record", record, *sample.map_options, *(("--publish",) if asked else ()))
    sent, came = _run("zenoh-bridge", [_DEMO], folder, "--seconds", str(sample.map_s), *asked, to=to)
    again = folder / "again"
    play(record, again, *(("--set", "mapper.mapping.requests.max_failures=0") if sample.map_options else ()))
    live, recorded = ([t.box for t in open_map(path).snapshot.objects] for path in (out, again))
    matches = match_boxes(recorded, live, STRICT_IOU)
    away, back = _run("zenoh-bridge", [_DEMO], folder, *sample.away)
    figures = [
        figure(
            "live_latency_p95_ms",
            1e3 * _p95(came["latency_s"]),
            "ms",
            "lower",
            f"from the last image of a keyframe to its snapshot, 640x360 at 6 Hz, {len(came['latency_s'])} keyframes",
        ),
        figure("live_map_unaccounted", _unaccounted(sent, came), "messages", "lower"),
        figure(
            "live_vs_recorded_recall_50",
            len(matches) / len(recorded) if recorded else 0.0,
            "share",
            "higher",
            f"{len(recorded)} objects of the recording's map in the live one",
        ),
    ]
    if asked:
        figures += _published(sample, sent)
    if sample.mapped_720p_s:
        large = write_720p(_DEMO, folder / "mapped.mcap", seconds=sample.mapped_720p_s)
        _, slow = _run("zenoh-bridge", [large], folder, "--loop", "2", to=("--out", folder / "large"))
        told = f"the same at 1280x720 and 30 Hz, {len(slow['latency_s'])} keyframes"
        figures.append(figure("live_latency_720p_p95_ms", 1e3 * _p95(slow["latency_s"]), "ms", "lower", told))
    gaps_ns = np.diff(back["stamps_ns"])
    if len(gaps_ns) and away["returned_s"]:
        # The first frame after the gap in the stamps that the absence has left.
        first_s = back["came_s"][int(gaps_ns.argmax()) + 1]
        told = f"from the robot's return to the first frame; away {sample.away[-1]} (at:for)"
        figures.append(figure("reconnect_s", first_s - away["returned_s"][0], "s", "lower", told))
    return figures


def _goals(sample: Sample) -> list[str]:
    """Return what the robot is told to ask for while the map is made; goals that have no path are answered, too."""
    return [word for at in np.arange(2.0, sample.map_s, 0.25).tolist() for word in ("--goal", f"{at}:0.5,0.5")]


def _published(sample: Sample, sent: dict[str, Any]) -> list[Figure]:
    trips_s, heard = sent["round_trips_s"], sent["heard"]
    told = f"p95 of {len(trips_s)} of {len(_goals(sample)) // 2} goals, while the map is made"
    return [
        *([figure("plan_round_trip_ms", 1e3 * _p95(trips_s), "ms", "lower", told)] if trips_s else []),
        figure("published_messages", sum(heard.values()), "messages", "higher", ", ".join(sorted(heard))),
    ]


def _storm(sample: Sample, seed: int, folder: Path) -> list[Figure]:
    try:
        to = ("--out", folder / "storm", *sample.map_options)
        sent, came = _run("rmw-zenoh", [_DEMO], folder, *sample.storm, "--seed", str(seed), to=to)
    except RuntimeError as error:
        print(error, file=sys.stderr)
        return [figure("storm_crashes", 1, "crashes", "lower")]
    told = "loss, jitter, delay, 10 Mbit/s, disconnections, a restart at zero, a clock that is 5 min off"
    return [
        figure("storm_crashes", 0, "crashes", "lower", told),
        figure("storm_unaccounted", _unaccounted(sent, came), "messages", "lower"),
        figure("storm_frames", came["frames"], "frames", "higher"),
        figure("storm_peak_mb", came["peak_mb"], "MB", "lower"),
    ]


def _safety(sample: Sample, folder: Path) -> list[Figure]:
    found = early_safety(_DEMO, folder / "safety", seconds=sample.safety_s, has_shapes=not sample.map_options)
    things = f"{len(found.shown_s)} things within 3 m"
    never = len(found.shown_s) - len(found.safe_s)
    return [
        figure("time_to_safe_shape_s", _p95(list(found.safe_s.values())), "s", "lower", f"p95 of {things}"),
        figure(
            "time_to_safe_shape_log_s",
            _p95(list(found.safe_log_s.values())),
            "s",
            "lower",
            "the same by the stamps: 0 is the first keyframe that shows a thing",
        ),
        figure("never_safe_things", never, "things", "lower", f"of {things}, in {sample.safety_s:g} s"),
        figure("stand_in_contained_p5", _p5(found.contained), "share", "higher", "of the surface seen so far"),
        figure("avoided_p5", _p5(found.avoided), "share", "higher", "the same with occupied space"),
        *(
            [figure("stand_in_volume_ratio_p95", _p95(found.volumes), "ratio", "lower", "to the final layer 4")]
            if found.volumes
            else []
        ),
    ]


def _run(
    via: str, logs: list[Path], folder: Path, *faults: str, to: tuple[str | Path, ...] = ()
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Have a robot play to a receiver; return what the one says it sent and what the other says has come.

    Raises:
        RuntimeError: one of them failed.
    """
    if via == "mcap":
        place = str(folder / "pipe")
        where = ("--listen", place)
        if not Path(place).exists():
            os.mkfifo(place)
        uri = f"mcap:{place}"
    elif via == "dds":
        # Ports are those of the domain; runs at the same time are not to hear one another.
        domain = 1 + os.getpid() % 100
        where, uri = ("--domain", str(domain)), f"dds://{domain}"
    else:
        place = f"127.0.0.1:{_free_port()}"
        where, uri = ("--listen", place), f"{_SCHEMES[via]}://{place}"
    robot = [sys.executable, "-m", "tools.robot.command", *map(str, logs), "--via", via, *where, "--wait"]
    receiver = [sys.executable, "-m", "tools.benchmarks.live.receiver", uri]
    receiver += [str(word) for word in to]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": ROOT}
    with (
        subprocess.Popen([*robot, *faults], **pipes) as sending,
        subprocess.Popen(receiver, stdin=subprocess.PIPE, **pipes) as receiving,
    ):
        try:
            said, robot_error = sending.communicate(timeout=_TIMEOUT_S)
            heard, receiver_error = receiving.communicate(timeout=_TIMEOUT_S)
        finally:
            sending.kill()
            receiving.kill()
    if sending.returncode or receiving.returncode:
        raise RuntimeError(f"{via}: the robot said {robot_error[-500:]!r}, the receiver {receiver_error[-500:]!r}")
    return json.loads(said), json.loads(heard.splitlines()[-1])


def _unaccounted(sent: dict[str, Any], came: dict[str, Any]) -> int:
    """Return how many messages that were sent to somebody are in no bucket of the receiver's ledger."""
    missing = [abs(number - came["totals"].get(topic, 0)) for topic, number in sent["sent"].items()]
    return sum(missing) + abs(came["difference"])


def _p95(values: list[float]) -> float:
    return float(np.percentile(values, 95)) if values else 0.0


def _p5(values: list[float]) -> float:
    return float(np.percentile(values, 5)) if values else 0.0


def _free_port() -> int:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        return int(server.getsockname()[1])
