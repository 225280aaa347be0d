"""What the engine promises: one log one map, nothing lost to a kill, no stall, no growth, a quick stop.

On the first seconds of the embedded recording, with coarse shapes where only the engine is measured. A quick run takes
a smaller sample of each.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from hickory_stream.engine.session import open_map
from hickory_stream.errors import MapFolderError
from tools.benchmarks.figures import Figure, Options
from tools.benchmarks.processes import ROOT

if TYPE_CHECKING:
    from collections.abc import Callable

_LOG = ROOT / "recordings" / "demo.mcap"
_COARSE = (
    "mapper.shapes.fused.volume.cells=16",
    "mapper.shapes.fit.cells=16",
    "mapper.shapes.fit.num_seeds=1",
    "mapper.shapes.fit.num_candidates=1",
    "mapper.shapes.fit.max_primitives=1",
    "mapper.shapes.fit.coarse_samples=100",
    "mapper.shapes.fit.coarse_iterations=3",
    "mapper.shapes.fit.fine_samples=300",
    "mapper.shapes.fit.fine_iterations=4",
    "mapper.shapes.fit.gain_samples=1000",
    # Asked for early, so that a short run has jobs under way most of the time.
    "mapper.mapping.requests.first_sightings=4",
    "mapper.mapping.requests.latency_s=1.0",
    "mapper.run.shape_cache=false",
)
_SLOWER = 10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """How much is measured: runs, kills and stops; frames of the log that each plays; seconds of the live runs."""

    runs: int
    kills: int
    stops: int
    frames: int
    live_s: float
    stall_s: float
    soak_s: float
    soak_warm_s: float


FULL = Sample(runs=20, kills=100, stops=10, frames=40, live_s=60.0, stall_s=60.0, soak_s=3600.0, soak_warm_s=300.0)
QUICK = Sample(runs=2, kills=1, stops=1, frames=12, live_s=4.0, stall_s=2.0, soak_s=9.0, soak_warm_s=4.0)


def measure(options: Options) -> list[Figure]:
    """Return the figures."""
    return measured(QUICK if options.quick else FULL, random.Random(options.seed))


def measured(sample: Sample, rng: random.Random) -> list[Figure]:
    """Return the figures of a sample; each kind of measurement prints a line when it is done."""
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        steps: tuple[Callable[[Sample, random.Random, Path], list[Figure]], ...] = (
            _determinism,
            _kills,
            _stops,
            _live,
            _soak,
        )
        for step in steps:
            started = time.perf_counter()
            found = step(sample, rng, folder)
            told = ", ".join(f"{figure.name} {figure.value:g}" for figure in found)
            print(f"{told} ({time.perf_counter() - started:.0f} s)", flush=True)
            figures += found
    return figures


# ---- one log, one map -----------------------------------------------------------------------------------------------


def _determinism(sample: Sample, rng: random.Random, folder: Path) -> list[Figure]:
    """Play with 1 to 4 workers, slow ones, killed ones, pauses of the whole process, a rate; count the digests."""
    slow = _slow_interpreter(folder / "slow-python")
    digests, delays_ms = set(), []
    for i in range(sample.runs):
        out = folder / "run"
        arguments = ["--workers", str(1 + i % 4)]
        if i % 3 == 1:
            arguments += ["--set", f"mapper.run.worker_python={slow}"]
        if i % 5 == 2:
            arguments += ["--rate", f"{rng.uniform(2.0, 6.0):.2f}"]
        if i % 4 == 3:
            arguments += ["--rrd", str(folder / "run.rrd")]
        process = _play(out, sample.frames, *arguments)
        kills = 2 if i % 2 else 0
        while process.poll() is None:
            time.sleep(rng.uniform(0.2, 1.0))
            kills -= _disturb(process.pid, rng, kills=kills > 0, pauses=i % 5 == 4)
        digests.add(_finished(process)["digest"])
        if i % 5 == 0:
            delays_ms.append(open_map(out).timings["loop_delay_p99_ms"])
    return [
        _figure("digest_runs", sample.runs, "", "higher"),
        _figure("digests_distinct", len(digests), "", "lower"),
        _figure("loop_delay_p99_ms", min(delays_ms), "ms", "lower"),
    ]


def _disturb(pid: int, rng: random.Random, *, kills: bool, pauses: bool) -> int:
    """Pause the process, kill one of its workers, or leave it; return how many were killed."""
    num_killed = 0
    with suppress(psutil.Error):
        process = psutil.Process(pid)
        if kills and (children := process.children()):
            rng.choice(children).kill()
            num_killed = 1
        if pauses:
            process.suspend()
            time.sleep(rng.uniform(0.05, 0.4))
            process.resume()
    return num_killed


def _slow_interpreter(path: Path) -> Path:
    """Write a program that is our interpreter after a random while: what it answers is the same, only later."""
    path.write_text(f'#!/bin/sh\nsleep 0.$(od -An -N1 -tu1 /dev/urandom | tr -d " ")\nexec "{sys.executable}" "$@"\n')
    path.chmod(0o755)
    return path


# ---- kills and stops ------------------------------------------------------------------------------------------------


def _kills(sample: Sample, rng: random.Random, folder: Path) -> list[Figure]:
    """Kill the whole process group at a random moment, resume, compare; look for what was left running."""
    started = time.perf_counter()
    wanted = _finished(_play(folder / "calm", sample.frames))["digest"]
    whole_s = time.perf_counter() - started
    num_killed = num_recovered = num_orphans = 0
    while num_killed < sample.kills:
        out = folder / "killed"
        process = _play(out, sample.frames)
        time.sleep(rng.uniform(0.1, 1.0) * whole_s)
        family = _family(process.pid)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        if process.returncode == 0:
            continue  # it was over before the kill
        num_killed += 1
        num_orphans += _still_running(family)
        num_recovered += _is_recovered(out, sample.frames, wanted)
    return [
        _figure("kills", num_killed, "", "higher"),
        _figure("kills_recovered", num_recovered, "", "higher"),
        _figure("orphans", num_orphans, "", "lower"),
    ]


def _is_recovered(out: Path, frames: int, wanted: str) -> bool:
    """Return whether a killed run's folder opens, and goes on to the wanted map."""
    if not (out / "manifest.json").exists():
        return bool(_finished(_play(out, frames))["digest"] == wanted)  # killed before it made anything
    try:
        saved = open_map(out)
    except MapFolderError as error:
        print(f"the folder does not open: {error}", flush=True)
        return False
    if saved.manifest.finished_cleanly:
        return saved.manifest.digest == wanted
    resumed = subprocess.run(
        [sys.executable, "-m", "hickory_stream", "resume", str(out), "--json"], cwd=ROOT, capture_output=True, text=True
    )
    last = json.loads(resumed.stdout.splitlines()[-1])
    if last.get("digest") != wanted:
        print(f"not recovered: {last}", flush=True)
    return bool(last.get("digest") == wanted)


def _family(pid: int) -> list[psutil.Process]:
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return []


def _still_running(family: list[psutil.Process]) -> int:
    """Return how many processes outlive their run by two seconds."""
    _, alive = psutil.wait_procs(family, timeout=2.0)
    return len(alive)


def _stops(sample: Sample, rng: random.Random, folder: Path) -> list[Figure]:
    """Send SIGINT while keyframes are mapped; from there to the end of the process, with a complete saved map."""
    seconds = []
    for _ in range(sample.stops):
        out = folder / "stopped"
        process = _play(out, 120, "--set", "mapper.run.grace_s=0.0")
        assert process.stderr is not None
        wanted = rng.randint(2, 8)
        for line in process.stderr:
            if line.startswith("{") and json.loads(line).get("keyframes", 0) >= wanted:
                break
        began = time.perf_counter()
        process.send_signal(signal.SIGINT)
        process.communicate()
        seconds.append(time.perf_counter() - began)
        if open_map(out).manifest.digest is None:
            raise RuntimeError("a stopped run left no complete map")
    return [_figure("stop_seconds", max(seconds), "s", "lower")]


# ---- live -----------------------------------------------------------------------------------------------------------


def _live(sample: Sample, rng: random.Random, folder: Path) -> list[Figure]:
    """Map at 30 Hz with perception slowed tenfold, then as it is, then with a viewer that stalls."""
    del rng
    options = ("--seconds", str(sample.live_s), "--slower", str(_SLOWER), "--stall", str(sample.stall_s))
    command = [sys.executable, "-m", "tools.benchmarks.live_scene", str(folder / "live"), *options]
    ran = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    slowed, plain, stalled = (json.loads(line) for line in ran.stdout.splitlines()[-3:])
    slowdown = 1.0 - stalled["keyframes"] / plain["keyframes"]
    return [
        _figure("overload_rss_mb", slowed["peak_mb"], "MB", "lower"),
        _figure("overload_latency_keyframes", slowed["latency_keyframes"], "", "lower"),
        _figure("unaccounted_frames", sum(run["unaccounted"] for run in (slowed, plain, stalled)), "", "lower"),
        _figure("stalled_viewer_slowdown", max(0.0, slowdown), "", "lower"),
    ]


# ---- hours ----------------------------------------------------------------------------------------------------------


def _soak(sample: Sample, rng: random.Random, folder: Path) -> list[Figure]:
    """Play the log round after round; compare memory and open files at the end with those after a while."""
    del rng
    process = _play(folder / "soak", sample.frames, "--loop", "100000", stderr=subprocess.DEVNULL)
    watched = psutil.Process(process.pid)
    began = time.monotonic()
    samples: list[tuple[float, float, int]] = []
    while time.monotonic() - began < sample.soak_s and process.poll() is None:
        samples.append((time.monotonic() - began, watched.memory_info().rss / 1e6, watched.num_fds()))
        time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    process.communicate()
    # A window's peak rather than a moment: memory comes and goes with each keyframe.
    window_s = sample.soak_warm_s / 2
    warm = [s for s in samples if sample.soak_warm_s - window_s <= s[0] < sample.soak_warm_s]
    last = [s for s in samples if s[0] >= sample.soak_s - window_s]
    growth = max(s[1] for s in last) / max(s[1] for s in warm) - 1.0
    return [
        _figure("soak_seconds", sample.soak_s, "s", "higher"),
        _figure("soak_rss_growth_fraction", growth, "", "lower"),
        _figure("soak_open_files_growth", max(s[2] for s in last) - max(s[2] for s in warm), "", "lower"),
    ]


# ---- processes ------------------------------------------------------------------------------------------------------


def _play(out: Path, frames: int, *arguments: str, stderr: int = subprocess.PIPE) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "hickory_stream", "play", str(_LOG), "--out", str(out), "--overwrite"]
    command += ["--viewer", "none", "--json", "--frames", str(frames)]
    for override in _COARSE:
        command += ["--set", override]
    return subprocess.Popen(
        [*command, *arguments],
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
        stderr=stderr,
        start_new_session=True,
    )


def _finished(process: subprocess.Popen[str]) -> dict[str, Any]:
    stdout, stderr = process.communicate()
    if process.returncode != 0:
        raise RuntimeError(f"play ended with {process.returncode}: {stderr.splitlines()[-1:]}")
    finished: dict[str, Any] = json.loads(stdout.splitlines()[-1])
    return finished


def _figure(name: str, value: float, unit: str, better: str) -> Figure:
    return Figure(name=name, value=float(value), unit=unit, better="lower" if better == "lower" else "higher")
