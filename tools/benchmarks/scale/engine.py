"""What the engine promises: one log one map, nothing lost to a kill, no stall, no growth, a quick stop.

On the first seconds of the embedded recording, with coarse shapes where only the engine is measured. A quick run takes
a smaller sample of each. A whole one takes hours: it can be broken off at any moment, and the next one goes on.
"""

from __future__ import annotations

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil

from hickory_stream.engine.saved_map import open_map
from hickory_stream.errors import InputError, MapFolderError
from tools.benchmarks.common.coarse_runs import die_with_parent, finished, play_coarsely
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT
from tools.benchmarks.common.repetitions import Repetitions, measurement_folder
from tools.benchmarks.scale.processors import digest_on, variants

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
    soak_record_s: float
    # Frames that are played as on other processors; None: all of them, with whole shapes, on all processors.
    variant_frames: int | None


FULL = Sample(
    runs=20,
    kills=100,
    stops=10,
    frames=40,
    live_s=60.0,
    stall_s=60.0,
    soak_s=3600.0,
    # On a loaded machine with cold caches the first round of the log takes five minutes.
    soak_warm_s=600.0,
    soak_record_s=5.0,
    variant_frames=None,
)
QUICK = Sample(
    runs=2,
    kills=1,
    stops=1,
    frames=12,
    live_s=4.0,
    stall_s=2.0,
    soak_s=9.0,
    soak_warm_s=4.0,
    soak_record_s=0.2,
    variant_frames=6,
)


def measure(options: Options) -> list[Figure]:
    """Return the figures of the parts that are asked for; each prints a line when it is done, or its time is up.

    Raises:
        InputError: there is no such part.
        RuntimeError: another process is at one.
    """
    if unknown := set(options.only) - set(_PARTS):
        raise InputError(f"no part {', '.join(sorted(unknown))}; parts are {', '.join(_PARTS)}")
    sample = QUICK if options.quick else FULL
    until = time.monotonic() + 60.0 * options.minutes
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as temporary:
        kept = None
        if not options.quick:
            kept = measurement_folder(options.state, "engine", seed=options.seed, fresh=options.fresh)
            print(f"kept in {kept}", flush=True)
        for name in options.only or _PARTS:
            started = time.perf_counter()
            folder = (kept or Path(temporary)) / name
            # What a broken off run left half done.
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            with closing(Repetitions(kept and kept / f"{name}.jsonl", until=until)) as repetitions:
                if repetitions.records:
                    print(f"{name}: goes on after {len(repetitions.records)} records", flush=True)
                found = _PARTS[name](sample, options.seed, repetitions, folder)
            told = ", ".join(f"{figure.name} {figure.value:g}" for figure in found) or f"{name}: nothing yet"
            print(f"{told} ({time.perf_counter() - started:.0f} s)", flush=True)
            figures += found
            shutil.rmtree(folder)
    return figures


# ---- one log, one map -----------------------------------------------------------------------------------------------


def _digests(sample: Sample, seed: int, repetitions: Repetitions, folder: Path) -> list[Figure]:
    """Play with 1 to 4 workers, slow ones, killed ones, pauses of the whole process, a rate; count the digests."""
    slow = _slow_interpreter(folder / "slow-python")
    for i in repetitions.missing(sample.runs):
        rng = random.Random(f"digests {seed} {i}")
        out = folder / "run"
        arguments = ["--workers", str(1 + i % 4)]
        if i % 3 == 1:
            arguments += ["--set", f"mapper.run.worker_python={slow}"]
        if i % 5 == 2:
            arguments += ["--rate", f"{rng.uniform(2.0, 6.0):.2f}"]
        if i % 4 == 3:
            arguments += ["--rrd", str(folder / "run.rrd")]
        process = play_coarsely(out, sample.frames, *arguments)
        kills = 2 if i % 2 else 0
        while process.poll() is None:
            time.sleep(rng.uniform(0.2, 1.0))
            kills -= _disturb(process.pid, rng, kills=kills > 0, pauses=i % 5 == 4)
        digest = finished(process)["digest"]
        repetitions.add(digest=digest, delay_ms=open_map(out).timings["loop_delay_p99_ms"], disturbed=i % 5 != 0)
    records = repetitions.records
    if not records:
        return []
    return [
        figure("digest_runs", len(records), "", "higher"),
        figure("digests_distinct", len({record["digest"] for record in records}), "", "lower"),
        figure(
            "loop_delay_p99_ms", min(record["delay_ms"] for record in records if not record["disturbed"]), "ms", "lower"
        ),
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


def _processors(sample: Sample, seed: int, repetitions: Repetitions, folder: Path) -> list[Figure]:
    """Play as on other processors, and count the digests."""
    del seed
    every = variants()
    chosen = every if sample.variant_frames is None else (every[0], *every[-3:-1])
    for i in repetitions.missing(len(chosen)):
        digest = digest_on(chosen[i], folder / "run", frames=sample.variant_frames)
        print(f"{digest[:16]} {chosen[i].name}", flush=True)
        repetitions.add(name=chosen[i].name, digest=digest)
    if not repetitions.records:
        return []
    return [
        figure("digest_variants", len(repetitions.records), "", "higher"),
        figure("digest_variants_distinct", len({record["digest"] for record in repetitions.records}), "", "lower"),
    ]


# ---- kills and stops ------------------------------------------------------------------------------------------------


def _kills(sample: Sample, seed: int, repetitions: Repetitions, folder: Path) -> list[Figure]:
    """Kill the whole process group at a random moment, resume, compare; look for what was left running."""
    # The first record is of a run that nobody disturbs.
    for _ in repetitions.missing(1):
        started = time.perf_counter()
        digest = finished(play_coarsely(folder / "calm", sample.frames))["digest"]
        repetitions.add(digest=digest, seconds=time.perf_counter() - started)
    if not repetitions.records:
        return []
    calm, killed = repetitions.records[0], _killed(repetitions)
    while len(killed) < sample.kills and not repetitions.is_time_up:
        i = len(repetitions.records)
        process = play_coarsely(folder / "killed", sample.frames)
        # A busier machine than that of the first run only makes the kills come earlier in the run.
        after_s = random.Random(f"kills {seed} {i}").uniform(0.1, 1.0) * calm["seconds"]
        with suppress(subprocess.TimeoutExpired):
            process.wait(after_s)
        family = _family(process.pid)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        was_over = process.returncode == 0
        orphans = _still_running(family)
        why_not = _why_not_recovered(folder / "killed", sample.frames, calm["digest"])
        if why_not is not None:
            print(f"kill {i}, {after_s:.2f} s after the start: {why_not}", flush=True)
            shutil.copytree(folder / "killed", folder.with_name(f"not-recovered-{i:03d}"), dirs_exist_ok=True)
        repetitions.add(after_s=after_s, was_over=was_over, orphans=orphans, why_not=why_not)
        killed = _killed(repetitions)
    return [
        figure("kills", len(killed), "", "higher"),
        figure("kills_recovered", sum(record["why_not"] is None for record in killed), "", "higher"),
        figure("orphans", sum(record["orphans"] for record in killed), "", "lower"),
    ]


def _killed(repetitions: Repetitions) -> list[dict[str, Any]]:
    """Return the records of the runs that were not over before their kill."""
    return [record for record in repetitions.records[1:] if not record["was_over"]]


def _why_not_recovered(out: Path, frames: int, wanted: str) -> str | None:
    """Return why a killed run's folder does not open and go on to the wanted map; None where it does."""
    if not (out / "manifest.json").exists():  # killed before it made anything
        digest = finished(play_coarsely(out, frames))["digest"]
        return None if digest == wanted else f"another digest when played again: {digest}"
    try:
        saved = open_map(out)
    except MapFolderError as error:
        return f"the folder does not open: {error}"
    if saved.manifest.finished_cleanly:
        return None if saved.manifest.digest == wanted else f"finished with another digest: {saved.manifest.digest}"
    resumed = subprocess.run(
        [sys.executable, "-m", "hickory_stream", "resume", str(out), "--json"], cwd=ROOT, capture_output=True, text=True
    )
    last = (resumed.stdout.splitlines() or ["{}"])[-1]
    if json.loads(last).get("digest") == wanted:
        return None
    return f"resume ended with {resumed.returncode}: {last} {resumed.stderr.splitlines()[-1:]}"


def _family(pid: int) -> list[psutil.Process]:
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return []


def _still_running(family: list[psutil.Process]) -> int:
    """Return how many processes outlive their run by two seconds."""
    _, alive = psutil.wait_procs(family, timeout=2.0)
    return len(alive)


def _stops(sample: Sample, seed: int, repetitions: Repetitions, folder: Path) -> list[Figure]:
    """Send SIGINT while keyframes are mapped; from there to the end of the process, with a complete saved map."""
    for i in repetitions.missing(sample.stops):
        out = folder / "stopped"
        process = play_coarsely(out, 120, "--set", "mapper.run.grace_s=0.0")
        assert process.stderr is not None
        wanted = random.Random(f"stops {seed} {i}").randint(2, 8)
        for line in process.stderr:
            if line.startswith("{") and json.loads(line).get("keyframes", 0) >= wanted:
                break
        began = time.perf_counter()
        process.send_signal(signal.SIGINT)
        process.communicate()
        if open_map(out).manifest.digest is None:
            raise RuntimeError("a stopped run left no complete map")
        repetitions.add(seconds=time.perf_counter() - began)
    if not repetitions.records:
        return []
    slowest = max(record["seconds"] for record in repetitions.records)
    return [figure("stops", len(repetitions.records), "", "higher"), figure("stop_seconds", slowest, "s", "lower")]


# ---- live -----------------------------------------------------------------------------------------------------------


def _live(sample: Sample, seed: int, repetitions: Repetitions, folder: Path) -> list[Figure]:
    """Map at 30 Hz with perception slowed tenfold, then as it is, then with a viewer that stalls."""
    del seed
    for _ in repetitions.missing(1):
        options = ("--seconds", str(sample.live_s), "--slower", str(_SLOWER), "--stall", str(sample.stall_s))
        command = [sys.executable, "-m", "tools.benchmarks.live.overload", str(folder / "live"), *options]
        ran = subprocess.run(
            command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True, preexec_fn=die_with_parent
        )
        repetitions.add(runs=[json.loads(line) for line in ran.stdout.splitlines()[-3:]])
    if not repetitions.records:
        return []
    slowed, plain, stalled = runs = repetitions.records[0]["runs"]
    slowdown = 1.0 - stalled["keyframes"] / plain["keyframes"]
    return [
        figure("overload_rss_mb", slowed["peak_mb"], "MB", "lower"),
        figure("overload_latency_keyframes", slowed["latency_keyframes"], "", "lower"),
        figure("unaccounted_frames", sum(run["unaccounted"] for run in runs), "", "lower"),
        figure("stalled_viewer_slowdown", max(0.0, slowdown), "", "lower"),
    ]


# ---- hours ----------------------------------------------------------------------------------------------------------


def _soak(sample: Sample, seed: int, repetitions: Repetitions, folder: Path) -> list[Figure]:
    """Play the log round after round; compare memory and open files at the end with those after a while.

    One process goes all the way, so one that is broken off is begun again; what it showed until then is kept, and the
    figures are of the one that went furthest.
    """
    del seed
    goal_s = sample.soak_s
    if not repetitions.is_time_up and not any(record["at_s"] >= goal_s for record in repetitions.records):
        attempt = 1 + max((record["attempt"] for record in repetitions.records), default=0)
        _soak_once(sample, attempt, repetitions, folder)
    furthest = max(repetitions.records, key=lambda record: record["at_s"], default=None)
    if furthest is None:
        return []
    figures = [
        figure("soak_seconds", min(furthest["at_s"], goal_s), "s", "higher"),
        figure("soak_journal_mb", furthest["journal_mb"], "MB", "lower"),
    ]
    # A window's peak rather than a moment: memory comes and goes with each keyframe.
    window_s = sample.soak_warm_s / 2
    shown = [record for record in repetitions.records if record["attempt"] == furthest["attempt"]]
    warm = [record for record in shown if sample.soak_warm_s - window_s <= record["at_s"] < sample.soak_warm_s]
    last = [record for record in shown if record["at_s"] >= furthest["at_s"] - window_s]
    if not warm or furthest["at_s"] < sample.soak_warm_s + window_s:
        return figures  # it went on for too short a time to say
    growth = max(record["rss_mb"] for record in last) / max(record["rss_mb"] for record in warm) - 1.0
    files = max(record["open_files"] for record in last) - max(record["open_files"] for record in warm)
    return [
        *figures,
        figure("soak_rss_growth_fraction", growth, "", "lower"),
        figure("soak_open_files_growth", files, "", "lower"),
    ]


def _soak_once(sample: Sample, attempt: int, repetitions: Repetitions, folder: Path) -> None:
    """Play until the end of the soak, or of the time; every few seconds, keep the peaks since the last record."""
    out = folder / "map"
    said = folder / "said"
    with said.open("w") as stderr:
        process = play_coarsely(out, sample.frames, "--loop", "100000", stderr=stderr)
        watched = psutil.Process(process.pid)
        began = time.monotonic()
        at_s = 0.0
        while at_s < sample.soak_s and not repetitions.is_time_up:
            rss_mb, open_files, kept_s = 0.0, 0, at_s
            while at_s < min(kept_s + sample.soak_record_s, sample.soak_s):
                time.sleep(0.2)
                if process.poll() is not None:
                    raise RuntimeError(
                        f"play ended after {at_s:.0f} s of the soak: {said.read_text().splitlines()[-1:]}"
                    )
                at_s = time.monotonic() - began
                rss_mb = max(rss_mb, watched.memory_info().rss / 1e6)
                open_files = max(open_files, watched.num_fds())
            journal = out / "journal.mcap"
            journal_mb = journal.stat().st_size / 1e6 if journal.exists() else 0.0
            repetitions.add(attempt=attempt, at_s=at_s, rss_mb=rss_mb, open_files=open_files, journal_mb=journal_mb)
        process.send_signal(signal.SIGINT)
        process.communicate()
    if open_map(out).manifest.digest is None:
        raise RuntimeError("the soak left no complete map")


_PARTS: dict[str, Callable[[Sample, int, Repetitions, Path], list[Figure]]] = {
    "digests": _digests,
    "kills": _kills,
    "stops": _stops,
    "live": _live,
    "soak": _soak,
    "processors": _processors,
}
