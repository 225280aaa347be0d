"""Promises of the engine: one log one map, nothing lost to a kill, no stall, no growth, a quick stop."""
# On the first seconds of the embedded recording, with coarse shapes where only the engine is measured. A quick run
# takes a smaller sample of each. A whole one takes hours: it can be stopped at any moment, and the next one continues.

import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from hickory_stream.errors import InputError, MapFolderError
from hickory_stream.map_folder.saved_map import open_map
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT, finished, in_child, overridden, play_coarsely
from tools.benchmarks.common.repetitions import Repetitions, measurement_folder
from tools.benchmarks.live.overload import overloads

_SLOWER = 10.0


@dataclass(frozen=True, kw_only=True, slots=True)
class Sample:
    """The size of a run: runs, kills and stops; frames of the log that each plays; seconds of the live runs."""

    # `variant_frames` are played as on other processors; None: all of them, with whole shapes, on all processors.

    runs: int = 20
    kills: int = 100
    stops: int = 10
    frames: int = 40
    live_s: float = 60.0
    stall_s: float = 60.0
    soak_s: float = 3600.0
    # On a loaded machine with cold caches the first round of the log takes five minutes.
    soak_warm_s: float = 600.0
    soak_record_s: float = 5.0
    variant_frames: int | None = None


QUICK = Sample(
    runs=2, kills=1, stops=1, frames=12, live_s=4.0, stall_s=2.0, soak_s=9.0, soak_warm_s=4.0, soak_record_s=0.2,
    variant_frames=6,
)  # fmt: skip


@dataclass(frozen=True, kw_only=True, slots=True)
class Work:
    """One part of a run: its sample and seed, its records so far, and a folder for its maps."""

    sample: Sample
    seed: int
    repetitions: Repetitions
    folder: Path

    @property
    def records(self) -> list[dict[str, Any]]:
        return self.repetitions.records

    def values(self, name: str) -> list[Any]:
        return [record[name] for record in self.records]

    def random(self, name: str, index: int) -> random.Random:
        return random.Random(f"{name} {self.seed} {index}")


def measure(options: Options) -> list[Figure]:
    """Return the figures of the requested parts; each prints a line when it is done, or its time is up."""
    # Raises InputError: there is no such part.
    # Raises RuntimeError: another process is at one.
    if unknown := set(options.only) - set(_PARTS):
        raise InputError(f"no part {', '.join(sorted(unknown))}; parts are {', '.join(_PARTS)}")
    until = time.monotonic() + 60.0 * options.minutes
    figures: list[Figure] = []
    with tempfile.TemporaryDirectory() as temporary:
        stored = None
        if not options.quick:
            stored = measurement_folder(options.state, "engine", seed=options.seed, fresh=options.fresh)
            print(f"kept in {stored}", flush=True)
        for name in options.only or _PARTS:
            started = time.perf_counter()
            folder = (stored or Path(temporary)) / name
            # Left half done by a run that was stopped.
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            with closing(Repetitions(stored and stored / f"{name}.jsonl", until=until)) as repetitions:
                if repetitions.records:
                    print(f"{name}: goes on after {len(repetitions.records)} records", flush=True)
                sample = QUICK if options.quick else Sample()
                work = Work(sample=sample, seed=options.seed, repetitions=repetitions, folder=folder)
                measure_part, of_records = _PARTS[name]
                measure_part(work)
                found = of_records(work) if work.records else []
            values = ", ".join(f"{one.name} {one.value:g}" for one in found) or f"{name}: nothing yet"
            print(f"{values} ({time.perf_counter() - started:.0f} s)", flush=True)
            figures += found
            shutil.rmtree(folder)
    return figures


def _digests(work: Work) -> None:
    # Our interpreter after a random while: its answers are the same, only later.
    sleep = 'sleep 0.$(od -An -N1 -tu1 /dev/urandom | tr -d " ")'
    slow = work.folder / "slow-python"
    slow.write_text(f'#!/bin/sh\n{sleep}\nexec "{sys.executable}" "$@"\n')
    slow.chmod(0o755)
    for i in work.repetitions.missing(work.sample.runs):
        rng = work.random("digests", i)
        arguments = ["--workers", str(1 + i % 4)]
        arguments += overridden(f"run.worker_python={slow}") if i % 3 == 1 else []
        arguments += ["--rate", f"{rng.uniform(2.0, 6.0):.2f}"] if i % 5 == 2 else []
        arguments += ["--rrd", str(work.folder / "run.rrd")] if i % 4 == 3 else []
        process = play_coarsely(work.folder / "run", work.sample.frames, *arguments)
        kills = 2 if i % 2 else 0
        while process.poll() is None:
            time.sleep(rng.uniform(0.2, 1.0))
            kills -= _disturb(process.pid, rng, kills=kills > 0, pauses=i % 5 == 4)
        digest = finished(process)["digest"]
        delay_ms = open_map(work.folder / "run").timings["loop_delay_p99_ms"]
        work.repetitions.add(digest=digest, delay_ms=delay_ms, disturbed=i % 5 != 0)


def _of_digests(work: Work) -> list[Figure]:
    calm_ms = [record["delay_ms"] for record in work.records if not record["disturbed"]]
    return [
        figure("digest_runs", len(work.records)),
        figure("digests_distinct", len(set(work.values("digest"))), "", "lower"),
        figure("loop_delay_p99_ms", min(calm_ms), "ms", "lower"),
    ]


def _disturb(pid: int, rng: random.Random, *, kills: bool, pauses: bool) -> int:
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


def _processors(work: Work) -> None:
    every = variants()
    chosen = every if work.sample.variant_frames is None else (every[0], *every[-3:-1])
    for i in work.repetitions.missing(len(chosen)):
        digest = digest_on(chosen[i], work.folder / "run", frames=work.sample.variant_frames)
        print(f"{digest[:16]} {chosen[i].name}", flush=True)
        work.repetitions.add(name=chosen[i].name, digest=digest)


def _of_processors(work: Work) -> list[Figure]:
    return [
        figure("digest_variants", len(work.records)),
        figure("digest_variants_distinct", len(set(work.values("digest"))), "", "lower"),
    ]


def _kills(work: Work) -> None:
    frames, out = work.sample.frames, work.folder / "killed"
    # The first record is of an undisturbed run.
    for _ in work.repetitions.missing(1):
        started = time.perf_counter()
        digest = finished(play_coarsely(work.folder / "calm", frames))["digest"]
        work.repetitions.add(digest=digest, seconds=time.perf_counter() - started)
    while len(_killed(work)) < work.sample.kills and not work.repetitions.is_time_up:
        i, calm = len(work.records), work.records[0]
        process = play_coarsely(out, frames)
        # On a busier machine than in the first run the kills only come earlier in the run.
        after_s = work.random("kills", i).uniform(0.1, 1.0) * calm["seconds"]
        with suppress(subprocess.TimeoutExpired):
            process.wait(after_s)
        family = []
        with suppress(psutil.Error):
            family = psutil.Process(process.pid).children(recursive=True)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        was_over = process.returncode == 0
        # Processes that outlive their run by two seconds.
        orphans = len(psutil.wait_procs(family, timeout=2.0)[1])
        why_not = _why_not_recovered(out, frames, calm["digest"])
        if why_not is not None:
            print(f"kill {i}, {after_s:.2f} s after the start: {why_not}", flush=True)
            shutil.copytree(out, work.folder.with_name(f"not-recovered-{i:03d}"), dirs_exist_ok=True)
        work.repetitions.add(after_s=after_s, was_over=was_over, orphans=orphans, why_not=why_not)


def _of_kills(work: Work) -> list[Figure]:
    killed = _killed(work)
    return [
        figure("kills", len(killed)),
        figure("kills_recovered", sum(record["why_not"] is None for record in killed)),
        figure("orphans", sum(record["orphans"] for record in killed), "", "lower"),
    ]


def _killed(work: Work) -> list[dict[str, Any]]:
    return [record for record in work.records[1:] if not record["was_over"]]


def _why_not_recovered(out: Path, frames: int, wanted: str) -> str | None:
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


def _stops(work: Work) -> None:
    out = work.folder / "stopped"
    for i in work.repetitions.missing(work.sample.stops):
        process = play_coarsely(out, 120, *overridden("run.grace_s=0.0"))
        wanted = work.random("stops", i).randint(2, 8)
        for line in process.stderr or ():
            if line.startswith("{") and json.loads(line).get("keyframes", 0) >= wanted:
                break
        began = time.perf_counter()
        process.send_signal(signal.SIGINT)
        process.communicate()
        if open_map(out).manifest.digest is None:
            raise RuntimeError("a stopped run left no complete map")
        work.repetitions.add(seconds=time.perf_counter() - began)


def _of_stops(work: Work) -> list[Figure]:
    return [figure("stops", len(work.records)), figure("stop_seconds", max(work.values("seconds")), "s", "lower")]


def _live(work: Work) -> None:
    for _ in work.repetitions.missing(1):
        runs = in_child(overloads, work.folder / "live", work.sample.live_s, _SLOWER, work.sample.stall_s)
        work.repetitions.add(runs=runs)


def _of_live(work: Work) -> list[Figure]:
    slowed, plain, stalled = runs = work.records[0]["runs"]
    slowdown = 1.0 - stalled["keyframes"] / plain["keyframes"]
    return [
        figure("overload_rss_mb", slowed["peak_mb"], "MB", "lower"),
        figure("overload_latency_keyframes", slowed["latency_keyframes"], "", "lower"),
        figure("unaccounted_frames", sum(run["unaccounted"] for run in runs), "", "lower"),
        figure("stalled_viewer_slowdown", max(0.0, slowdown), "", "lower"),
    ]


def _soak(work: Work) -> None:
    # Play the log round after round until the end of the soak, or of the time; store peaks every few seconds. One
    # process goes all the way, so a stopped one begins again as another attempt.
    sample, repetitions, out, log = work.sample, work.repetitions, work.folder / "map", work.folder / "stderr"
    if repetitions.is_time_up or any(at_s >= sample.soak_s for at_s in work.values("at_s")):
        return
    attempt = 1 + max(work.values("attempt"), default=0)
    with log.open("w") as stderr:
        process = play_coarsely(out, sample.frames, "--loop", "100000", stderr=stderr)
        watched = psutil.Process(process.pid)
        began, at_s = time.monotonic(), 0.0
        while at_s < sample.soak_s and not repetitions.is_time_up:
            rss_mb, open_files, recorded_s = 0.0, 0, at_s
            while at_s < min(recorded_s + sample.soak_record_s, sample.soak_s):
                time.sleep(0.2)
                if process.poll() is not None:
                    last = log.read_text().splitlines()[-1:]
                    raise RuntimeError(f"play ended after {at_s:.0f} s of the soak: {last}")
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


def _of_soak(work: Work) -> list[Figure]:
    furthest, warm_s = max(work.records, key=lambda record: record["at_s"]), work.sample.soak_warm_s
    figures = [
        figure("soak_seconds", min(furthest["at_s"], work.sample.soak_s), "s"),
        figure("soak_journal_mb", furthest["journal_mb"], "MB", "lower"),
    ]
    # A window's peak rather than a moment: memory comes and goes with each keyframe.
    window_s = warm_s / 2
    shown = [record for record in work.records if record["attempt"] == furthest["attempt"]]
    warm = [record for record in shown if warm_s - window_s <= record["at_s"] < warm_s]
    last = [record for record in shown if record["at_s"] >= furthest["at_s"] - window_s]
    if not warm or furthest["at_s"] < warm_s + window_s:
        return figures  # too short for a comparison
    (warm_mb, warm_files), (last_mb, last_files) = (
        [max(record[name] for record in records) for name in ("rss_mb", "open_files")] for records in (warm, last)
    )
    return [
        *figures,
        figure("soak_rss_growth_fraction", last_mb / warm_mb - 1.0, "", "lower"),
        figure("soak_open_files_growth", last_files - warm_files, "", "lower"),
    ]


_PARTS: dict[str, tuple[Callable[[Work], None], Callable[[Work], list[Figure]]]] = {
    "digests": (_digests, _of_digests), "kills": (_kills, _of_kills), "stops": (_stops, _of_stops),
    "live": (_live, _of_live), "soak": (_soak, _of_soak), "processors": (_processors, _of_processors),
}  # fmt: skip


# Portability of maps: the same log is played while libraries choose their code as on other processors.
# Each variant has one library choose its code as on another machine, by the library's own switch; the last ones set all
# switches. One compiles the kernels for any x86-64, which takes minutes.
_LIBC = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4,-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ"}
_IMAGES = {
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,AVX,SSE4.2,SSE4.1",
    "OPENCV_IPP": "disabled",
    # JPEG without vector code.
    "JSIMD_FORCENONE": "1",
}
_KERNELS = {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""}


@dataclass(frozen=True, kw_only=True, slots=True)
class Variant:
    """Another processor: its name, the environment that makes libraries choose its code, and whether for workers alone.

    `compiles`: Numba's kernels are compiled for it, into a cache of its own.
    """

    name: str
    environment: Mapping[str, str] = field(default_factory=dict)
    is_of_workers: bool = False
    compiles: bool = False


def variants() -> tuple[Variant, ...]:
    config = np.show_config(mode="dicts")
    assert config is not None
    # The groups of instructions for which NumPy has code beyond its least, and which this processor has.
    found = list(config["SIMD Extensions"].get("found", ()))
    newest = {"NPY_DISABLE_CPU_FEATURES": " ".join(name for name in found if "512" in name or name == "X86_V4")}
    none = {"NPY_DISABLE_CPU_FEATURES": " ".join(found)}
    oldest = {"OPENBLAS_CORETYPE": "Prescott", **none, **_LIBC, **_IMAGES}
    environments = {
        "this one": {},
        **{f"BLAS of {core}": {"OPENBLAS_CORETYPE": core} for core in ("SkylakeX", "Haswell", "Zen", "Prescott")},
        "NumPy without AVX-512": newest, "NumPy without AVX2 and FMA": none, "C library without AVX2 and FMA": _LIBC,
        "OpenCV and JPEG without AVX, SSE4 and IPP": _IMAGES, "all of these": oldest,
    }  # fmt: skip
    return (
        *(Variant(name=name, environment=environment) for name, environment in environments.items()),
        Variant(name="all of these, workers alone", environment=oldest, is_of_workers=True),
        Variant(name="all of these, kernels for any x86-64", environment={**oldest, **_KERNELS}, compiles=True),
    )


def digest_on(variant: Variant, folder: Path, *, frames: int | None = None) -> str:
    """Return the digest of the embedded recording, played as on another processor; coarsely, if only `frames` of it."""
    folder.mkdir(parents=True, exist_ok=True)
    # Kernels that are compiled first may take long.
    overrides = ["run.shape_cache=false", "run.job_timeout_s=600"]
    environment = dict(variant.environment)
    if variant.compiles:
        environment["HICKORY_CACHE"] = str(folder.parent / "cache-of-variants")
    if variant.is_of_workers:
        overrides.append(f"run.worker_python={_interpreter(folder / 'worker-python', environment)}")
        environment = {}
    process = play_coarsely(folder / "map", frames, *overridden(*overrides), env={**os.environ, **environment})
    return str(finished(process)["digest"])


def _interpreter(path: Path, environment: Mapping[str, str]) -> Path:
    exports = "".join(f'export {name}="{value}"\n' for name, value in environment.items())
    path.write_text(f'#!/bin/sh\n{exports}exec "{sys.executable}" "$@"\n')
    path.chmod(0o755)
    return path
