"""What size costs: a keyframe in a large map, memory and disk, readers, large alignments, real time, a batch.

Keyframes, memory, the folder and readers are measured on a recorded walk that is mapped again and again, room after
room (`scale_keyframe.py`): a thousand objects without rendering a building; what perception costs does not depend on
the map. `--quick` does that with 200 objects, with a walk that is played coarsely, aligns 1,000 objects, and takes the
embedded recording for `stages` and few short logs for `batch`. `--only` chooses of `keyframes`, `alignment`, `stages`,
`batch`, `building`. The last one belongs to the whole run alone: a building of about 1,000 objects and 20 minutes in
it, which takes hours where it is not in the cache.
"""

from __future__ import annotations

import heapq
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from hickory_stream.batch.run import BatchPlan, run_batch
from hickory_stream.config import MapperConfig
from hickory_stream.config_text import read_config
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from hickory_stream.worlds.building.building import BuildingSize
from hickory_stream.worlds.cache import cached_recording
from hickory_stream.worlds.recording_config import RecordingConfig
from players import SourceOptions
from tools.benchmarks.common.coarse_runs import COARSE, play_coarsely
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT, play
from tools.benchmarks.scale.keyframe import Cost, scale_costs
from tools.benchmarks.scale.reading import reading_of
from tools.benchmarks.scale.stage_times import BUDGET_MS, STAGE_BUDGETS_MS, StageTimes, stage_times, table_of_stages

_PARTS = ("keyframes", "alignment", "stages", "batch", "building")
_QUICK_PARTS = ("keyframes", "alignment", "stages", "batch")
_DEMO = ROOT / "recordings" / "demo.mcap"
_WALK_FRAMES = 60
_APARTMENTS = tuple(
    RecordingConfig(scene="apartment", seed=seed, rate_hz=30.0, width=640, height=480, seconds=None)
    for seed in (1001, 1002, 1003)
)
_BUILDING = RecordingConfig(
    scene="building",
    seed=1,
    building=BuildingSize(floors=3, rooms=30),
    # About every frame of a walk is a keyframe: frames in between would triple the hours that rendering takes.
    rate_hz=3.0,
    width=640,
    height=480,
    seconds=1200.0,
)
_BATCH_SECONDS, _BATCH_LOGS, _QUICK_BATCH_LOGS = 10.0, 8, 4
_ALIGN = """
import resource, sys, time
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.evaluation.maps.simulate import SimulationConfig, simulate_pair
from hickory_stream.evaluation.maps.trial import error_of, overlap_b
small = simulate_pair(SimulationConfig(num_objects=20), 0)
align(small.map_a, small.map_b)
pair = simulate_pair(SimulationConfig(num_objects=int(sys.argv[2]), difficulty=sys.argv[3]), int(sys.argv[1]))
started = time.process_time()
answer = align(pair.map_a, pair.map_b)
seconds = time.process_time() - started
found = isinstance(answer, Alignment) and error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)).is_success
print(int(found), seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


def measure(options: Options) -> list[Figure]:
    """Return the figures of the parts that were asked for, printing what they were measured on."""
    parts = options.only or (_QUICK_PARTS if options.quick else _PARTS)
    print(f"on {os.cpu_count()} cores under a load of {os.getloadavg()[0]:.1f}: times are of processors", flush=True)
    with tempfile.TemporaryDirectory(prefix="hickory-scale-") as temporary:
        folder = Path(temporary)
        figures: list[Figure] = []
        if "keyframes" in parts:
            figures += _keyframes(folder, quick=options.quick)
        if "alignment" in parts:
            figures += _alignment(options.seed, quick=options.quick)
        if "stages" in parts:
            figures += _stages(folder, quick=options.quick)
        if "batch" in parts:
            figures += _batch(folder, _QUICK_BATCH_LOGS if options.quick else _BATCH_LOGS)
        if "building" in parts:
            figures += _building(folder)
    return figures


# ---- a keyframe in a large map, and what reads the map -------------------------------------------------------------


def _keyframes(folder: Path, *, quick: bool) -> list[Figure]:
    walk, large = folder / "walk", folder / "large"
    if quick:
        played = play_coarsely(walk, _WALK_FRAMES, stderr=subprocess.DEVNULL)
        played.communicate()
        if played.returncode != 0:
            raise RuntimeError(f"the walk ended with {played.returncode}")
    else:
        play(_DEMO, walk)
    costs, ratio, _ = scale_costs(walk, large, num_objects=200 if quick else 1000)
    for cost in costs:
        print(
            f"{cost.objects:>5} objects: {cost.keyframe_ms:6.1f} ms a keyframe (core {cost.core_ms:.1f}, journal "
            f"{cost.journal_ms:.1f}), a save {cost.save_all_ms:.0f} ms, of one keyframe {cost.save_ms:.0f}, "
            f"{cost.rss_mb:.0f} MB, folder {cost.folder_mb:.0f} MB",
            flush=True,
        )
    last, half = costs[-1], _at(costs, costs[-1].objects / 2)
    of = f"{len(costs)} rooms of {last.keyframes} keyframes, no perception"
    more = last.objects - half.objects
    save_ms = float(np.median([cost.save_ms for cost in costs if cost.save_ms][-5:]))
    save_all_ms = float(np.median([cost.save_all_ms for cost in costs if cost.save_all_ms][-5:]))
    reading = reading_of(large)
    known_of = f"{reading.objects} objects; {reading.known_records_seconds:.2f} s more for all records of half of them"
    known_of += f", {reading.known_points_seconds:.2f} s for their points"
    figures = [
        figure("scale_objects", last.objects, "", "higher", of),
        figure("scale_keyframe_ratio", ratio, "x", "lower", f"{of}; the core, in turn with a map of few objects"),
        figure("scale_rss_mb", last.rss_mb, "MB", "lower", f"{of}; the mapper's core and journal alone"),
        figure("scale_rss_mb_per_object", (last.rss_mb - half.rss_mb) / more, "MB", "lower", f"the last {more}"),
        figure(
            "scale_folder_mb_per_object",
            (last.folder_mb - half.folder_mb) / more,
            "MB",
            "lower",
            f"the last {more} objects; without images",
        ),
        figure("save_ms", save_ms, "ms", "lower", "what a keyframe changed"),
        figure("save_all_ms", save_all_ms, "ms", "lower", f"what {DiskSinkConfig().every_keyframes} keyframes did"),
        figure("open_seconds", reading.open_seconds, "s", "lower", f"{reading.objects} objects"),
        figure("known_at_seconds", reading.known_at_seconds, "s", "lower", known_of),
        figure("render_seconds", reading.render_seconds, "s", "lower", f"{reading.objects} objects"),
    ]
    if reading.path_ms is not None:
        told = f"{reading.num_paths} of 19 paths found; the grid before it {reading.space_seconds:.2f} s"
        figures.append(figure("first_path_ms", reading.path_ms, "ms", "lower", told))
    shutil.rmtree(large)
    return figures


def _at(costs: list[Cost], objects: float) -> Cost:
    """Return the cost with the number of objects that is nearest to a number."""
    return min(costs, key=lambda cost: abs(cost.objects - objects))


# ---- alignment ------------------------------------------------------------------------------------------------------


def _alignment(seed: int, *, quick: bool) -> list[Figure]:
    figures: list[Figure] = []
    for count, difficulty in ((1000, "hard"), *(() if quick else ((3000, "easy"),))):
        command = [sys.executable, "-c", _ALIGN, str(seed), str(count), difficulty]
        done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
        found, seconds, peak_mb = map(float, done.stdout.split())
        of = f"one pair, {difficulty}, a quarter of the objects in both; {'found' if found else 'not found'}"
        figures.append(figure(f"align_{count}_seconds", seconds, "s", "lower", of))
        figures.append(figure(f"align_{count}_mb", peak_mb, "MB", "lower", of))
    return figures


# ---- real time, by stage --------------------------------------------------------------------------------------------


def _stages(folder: Path, *, quick: bool) -> list[Figure]:
    """Return the real-time factor of apartments at 30 Hz, and print and return processor time by stage."""
    logs = [_DEMO] if quick else [cached_recording(config)[0] for config in _APARTMENTS]
    times: list[StageTimes] = []
    for log in logs:
        times.append(stage_times(log, folder / "staged"))
        print(f"{log.name}, {times[-1].keyframes} keyframes:\n{table_of_stages(times[-1])}", flush=True)
    keyframes, log_s = sum(one.keyframes for one in times), sum(one.log_s for one in times)
    told = "the demo, 6 Hz" if quick else f"{len(times)} apartments at 30 Hz"
    of = f"{told}, {keyframes} keyframes, load {os.getloadavg()[0]:.1f}"
    processor_s = sum(sum(one.seconds.values()) for one in times)
    figures = [
        figure("realtime_factor", log_s / sum(one.wall_s for one in times), "x", "higher", of),
        # What two cores make of it that do nothing else and never wait.
        figure("realtime_factor_by_processor", 2 * log_s / processor_s, "x", "higher", of),
        figure(
            "scale_folder_mb_per_minute",
            sum(one.folder_mb for one in times) / (log_s / 60),
            "MB",
            "lower",
            f"{of}; with journal and images",
        ),
    ]
    for stage, budget_ms in STAGE_BUDGETS_MS.items():
        spent = 1e3 * sum(one.seconds[stage] for one in times) / keyframes
        figures.append(figure(f"keyframe_{stage}_ms", spent, "ms", "lower", f"{of}; budget {budget_ms:.0f} ms"))
    figures.append(
        figure("keyframe_total_ms", 1e3 * processor_s / keyframes, "ms", "lower", f"{of}; budget {BUDGET_MS:.0f} ms")
    )
    return figures


# ---- a batch --------------------------------------------------------------------------------------------------------


def _batch(folder: Path, num_logs: int) -> list[Figure]:
    """Return how much faster two workers of one core each are than one, and whether digests are as of single runs.

    By the processor time of the tasks, handed to two workers in their order as each becomes free: what two cores that
    do nothing else take. By the clock other load decides; it is printed beside.
    """
    logs = [
        cached_recording(RecordingConfig(seed=seed, seconds=_BATCH_SECONDS, rate_hz=6.0, width=320, height=180))[0]
        for seed in range(num_logs)
    ]
    cores = sorted(os.sched_getaffinity(0))
    if len(cores) < 2:
        print("batch: left out, there is one core")
        return []
    walls, busiest, digests = [], [], []
    for count in (1, 2):
        os.sched_setaffinity(0, cores[:count])
        try:
            result = run_batch(_plan(logs, folder / f"batch{count}", count))
        finally:
            os.sched_setaffinity(0, cores)
        if not result.is_whole:
            raise RuntimeError(f"batch: {[row.outcome.reason for row in result.rows if row.outcome.reason]}")
        walls.append(result.wall_s)
        busiest.append(_makespan([row.outcome.cpu_s for row in result.rows], count))
        digests.append([row.outcome.digest for row in result.rows])
    overrides = [part for override in COARSE for part in ("--set", override)]
    single = [play(log, folder / "single", *overrides).finished["digest"] for log in logs]
    of = f"{len(logs)} logs of {_BATCH_SECONDS:.0f} s, processor time; by the clock {walls[0] / walls[1]:.2f} x"
    return [
        figure("batch_speedup", busiest[0] / busiest[1], "x", "higher", f"{of}, load {os.getloadavg()[0]:.1f}"),
        figure("batch_identical", float(digests[0] == digests[1] == single), "", "higher", f"{len(logs)} logs"),
    ]


def _makespan(seconds: list[float], workers: int) -> float:
    """Return when the last of some tasks ends, handed out in their order to whichever worker is free first."""
    free_at = [0.0] * workers
    for one in seconds:
        heapq.heapreplace(free_at, free_at[0] + one)
    return max(free_at)


def _plan(logs: list[Path], out: Path, workers: int) -> BatchPlan:
    overrides = tuple(override.removeprefix("mapper.") for override in COARSE)
    return BatchPlan(
        uris=tuple(map(str, logs)),
        options=SourceOptions(),
        out=out,
        mapper=read_config(MapperConfig, None, overrides),
        disk=DiskSinkConfig(),
        workers=workers,
    )


# ---- a building -----------------------------------------------------------------------------------------------------


def _building(folder: Path) -> list[Figure]:
    log, truth = cached_recording(_BUILDING)
    seconds = _BUILDING.seconds or 0.0
    played = play(log, folder / "building")
    size_mb = sum(file.stat().st_size for file in (folder / "building").rglob("*") if file.is_file()) / 1e6
    reading = reading_of(folder / "building")
    of = f"a building of {len(truth.objects)} objects, {seconds / 60:.0f} minutes at {_BUILDING.rate_hz:g} Hz"
    return [
        figure("building_objects", reading.objects, "", "higher", of),
        figure("building_peak_mb", played.peak_mb, "MB", "lower", f"{of}; mapper and workers"),
        figure("building_realtime_factor", seconds / played.seconds, "x", "higher", of),
        figure("building_folder_mb_per_minute", size_mb / (seconds / 60), "MB", "lower", of),
        figure("building_folder_mb_per_object", size_mb / max(1, reading.objects), "MB", "lower", of),
        figure("building_open_seconds", reading.open_seconds, "s", "lower", of),
        figure("building_render_seconds", reading.render_seconds, "s", "lower", of),
    ]
