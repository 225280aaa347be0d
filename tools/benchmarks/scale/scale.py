"""The costs of size: a keyframe in a large map, memory and disk, readers, large alignments, real time, a batch."""
# A recorded walk is mapped room after room (`keyframe.py`): a thousand objects without rendering a building; 200 for
# `--quick`.

import heapq
import os
import shutil
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hickory_stream.base.config_text import read_config
from hickory_stream.batch.run import BatchPlan, run_batch
from hickory_stream.config import MapperConfig
from hickory_stream.journal.reader import Journal
from hickory_stream.map_folder.saved_map import SavedMap, open_map
from hickory_stream.navigation.free_space import free_space_of
from hickory_stream.navigation.robot import load_robot
from hickory_stream.navigation.search import first_path
from hickory_stream.pictures.render import render_map
from hickory_stream.sinks.disk_sink import DiskSinkConfig
from players import SourceOptions
from tools.benchmarks.alignment.large_pair import large_pair
from tools.benchmarks.common.cached_runs import walk_recording
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import COARSE, DEMO, finished, in_child, overridden, play, play_coarsely
from tools.benchmarks.foreign.logs import outdoor_log
from tools.benchmarks.scale.keyframe import scale_costs, street_mb
from tools.benchmarks.scale.stage_times import BUDGET_MS, STAGE_BUDGETS_MS, stage_times
from tools.worlds.cache import cached_recording
from tools.worlds.recording_config import RecordingConfig

_QUICK_PARTS = ("keyframes", "alignment", "stages", "batch")
_PARTS = (*_QUICK_PARTS, "street")
_WALK_FRAMES = 60
_APARTMENTS = tuple(walk_recording("apartment", seed, rate_hz=30.0) for seed in (1001, 1002, 1003))
_STREET_M = 1000.0
_BATCH_SECONDS, _BATCH_LOGS, _QUICK_BATCH_LOGS = 10.0, 8, 4


def measure(options: Options) -> list[Figure]:
    """Return the figures of the requested parts, printing the data that they are measured on."""
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
        if "street" in parts:
            play(outdoor_log(options.seed).log, folder / "street")
            metres, rss_mb = street_mb(folder / "street", folder / "long", metres=_STREET_M)
            of = f"{metres:.0f} m of a street, walked again and again; no perception"
            figures.append(figure("street_mb", rss_mb, "MB", "lower", of))
    return figures


def _keyframes(folder: Path, *, quick: bool) -> list[Figure]:
    walk, large = folder / "walk", folder / "large"
    if quick:
        finished(play_coarsely(walk, _WALK_FRAMES))
    else:
        play(DEMO, walk)
    costs, ratio, _ = scale_costs(walk, large, num_objects=200 if quick else 1000)
    for cost in costs:
        print(
            f"{cost.objects:>5} objects: {cost.keyframe_ms:6.1f} ms a keyframe (core {cost.core_ms:.1f}, journal "
            f"{cost.journal_ms:.1f}), a save {cost.save_all_ms:.0f} ms, of one keyframe {cost.save_ms:.0f}, "
            f"{cost.rss_mb:.0f} MB, folder {cost.folder_mb:.0f} MB",
            flush=True,
        )
    last = costs[-1]
    half = min(costs, key=lambda cost: abs(cost.objects - last.objects / 2))
    more = last.objects - half.objects
    save_ms, save_all_ms = (
        np.median([value for cost in costs if (value := getattr(cost, name))][-5:])
        for name in ("save_ms", "save_all_ms")
    )
    reading = reading_of(large)
    shutil.rmtree(large)
    of = f"{len(costs)} rooms of {last.keyframes} keyframes, no perception"
    of_known = f"{reading.objects} objects; {reading.known_records_seconds:.2f} s more for all records of half of them"
    of_known += f", {reading.known_points_seconds:.2f} s for their points"
    of_ratio, of_rss = (
        f"{of}; the core, in turn with a map of few objects",
        f"{of}; the mapper's core and journal alone",
    )
    of_folder, objects = f"the last {more} objects; without images", f"{reading.objects} objects"
    of_save = f"the changes of {DiskSinkConfig().every_keyframes} keyframes"
    rss_mb, map_mb = (last.rss_mb - half.rss_mb) / more, (last.folder_mb - half.folder_mb) / more
    figures = [
        figure("scale_objects", last.objects, "", "higher", of),
        figure("scale_keyframe_ratio", ratio, "x", "lower", of_ratio),
        figure("scale_rss_mb", last.rss_mb, "MB", "lower", of_rss),
        figure("scale_rss_mb_per_object", rss_mb, "MB", "lower", f"the last {more}"),
        figure("scale_folder_mb_per_object", map_mb, "MB", "lower", of_folder),
        figure("save_ms", save_ms, "ms", "lower", "the changes of one keyframe"),
        figure("save_all_ms", save_all_ms, "ms", "lower", of_save),
        figure("open_seconds", reading.open_seconds, "s", "lower", objects),
        figure("known_at_seconds", reading.known_at_seconds, "s", "lower", of_known),
        figure("render_seconds", reading.render_seconds, "s", "lower", objects),
    ]
    if reading.path_ms is not None:
        of = f"{reading.num_paths} of 19 paths found; the grid before it {reading.space_seconds:.2f} s"
        figures.append(figure("first_path_ms", reading.path_ms, "ms", "lower", of))
    return figures


def _alignment(seed: int, *, quick: bool) -> list[Figure]:
    figures: list[Figure] = []
    for count, difficulty in ((1000, "hard"), *(() if quick else ((3000, "easy"),))):
        found = large_pair(seed, count, difficulty)
        of = f"one pair, {difficulty}, a quarter of the objects in both; {'found' if found.is_found else 'not found'}"
        figures.append(figure(f"align_{count}_seconds", found.seconds, "s", "lower", of))
        figures.append(figure(f"align_{count}_mb", found.peak_mb, "MB", "lower", of))
    return figures


def _stages(folder: Path, *, quick: bool) -> list[Figure]:
    times = []
    for log in [DEMO] if quick else [cached_recording(config)[0] for config in _APARTMENTS]:
        times.append(stage_times(log, folder / "staged"))
        print(f"{log.name}, {times[-1].keyframes} keyframes:\n{times[-1].table()}", flush=True)
    keyframes, log_s = sum(one.keyframes for one in times), sum(one.log_s for one in times)
    logs = "the demo, 6 Hz" if quick else f"{len(times)} apartments at 30 Hz"
    of = f"{logs}, {keyframes} keyframes, load {os.getloadavg()[0]:.1f}"
    spent_s = {stage: sum(one.seconds[stage] for one in times) for stage in STAGE_BUDGETS_MS}
    map_mb_a_minute, of_map = sum(one.map_mb for one in times) / (log_s / 60), f"{of}; with journal and images"
    total_s = sum(spent_s.values())
    return [
        figure("realtime_factor", log_s / sum(one.wall_s for one in times), "x", "higher", of),
        # On two cores without other work, which never wait.
        figure("realtime_factor_by_processor", 2 * log_s / total_s, "x", "higher", of),
        figure("scale_folder_mb_per_minute", map_mb_a_minute, "MB", "lower", of_map),
        *(
            figure(f"keyframe_{stage}_ms", 1e3 * spent_s[stage] / keyframes, "ms", "lower", f"{of}; budget {ms:.0f} ms")
            for stage, ms in STAGE_BUDGETS_MS.items()
        ),
        figure("keyframe_total_ms", 1e3 * total_s / keyframes, "ms", "lower", f"{of}; budget {BUDGET_MS:.0f} ms"),
    ]


def _batch(folder: Path, num_logs: int) -> list[Figure]:
    # By the processor time of the tasks, handed to two workers in their order: the time of two cores without other
    # work.
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
        plan = BatchPlan(
            uris=tuple(map(str, logs)), options=SourceOptions(), out=folder / f"batch{count}",
            mapper=read_config(MapperConfig, None, COARSE), disk=DiskSinkConfig(), workers=count,
        )  # fmt: skip
        os.sched_setaffinity(0, cores[:count])
        try:
            result = run_batch(plan)
        finally:
            os.sched_setaffinity(0, cores)
        if not result.is_whole:
            raise RuntimeError(f"batch: {[row.reason for row in result.rows if row.reason]}")
        walls.append(result.wall_s)
        busiest.append(_makespan([row.cpu_s for row in result.rows], count))
        digests.append([row.digest for row in result.rows])
    single = [play(log, folder / "single", *overridden(*COARSE)).finished["digest"] for log in logs]
    of = f"{len(logs)} logs of {_BATCH_SECONDS:.0f} s, processor time; by the clock {walls[0] / walls[1]:.2f} x"
    of += f", load {os.getloadavg()[0]:.1f}"
    return [
        figure("batch_speedup", busiest[0] / busiest[1], "x", "higher", of),
        figure("batch_identical", digests[0] == digests[1] == single, "", "higher", f"{len(logs)} logs"),
    ]


def _makespan(seconds: list[float], workers: int) -> float:
    free_at = [0.0] * workers
    for one in seconds:
        heapq.heapreplace(free_at, free_at[0] + one)
    return max(free_at)


# Times of readers of a large map, in a process of its own: opening, looking back, a path, a picture.
# Processor time; the first path, which loads kernels, is not counted. Opening and the picture do count loading.
_PICTURE_PX = (1600, 800)
_TRIES = 20


@dataclass(frozen=True, kw_only=True, slots=True)
class Reading:
    """Seconds of processor time; `space_seconds` is the grid that the paths are planned in."""

    # `path_ms`: median of `num_paths`. `known_...`: until records, then points, of the map at the middle of the run
    # were read.

    objects: int
    open_seconds: float
    known_at_seconds: float
    known_records_seconds: float
    known_points_seconds: float
    space_seconds: float
    path_ms: float | None
    num_paths: int
    render_seconds: float


def reading_of(folder: Path) -> Reading:
    found: Reading = in_child(_measured, folder)
    return found


def _measured(folder: Path) -> Reading:
    marks = [time.process_time()]
    saved = open_map(folder)
    marks.append(time.process_time())
    with Journal(folder) as journal:
        steps = [journal.step(i) for i in range(len(journal))]
        places = [step.frames[-1].world_from_camera[:2, 3] for step in steps if step.frames]
        stamp_ns = steps[len(steps) // 2].stamp_ns
    marks.append(time.process_time())
    snapshot = saved.as_known_at(stamp_ns)
    marks.append(time.process_time())
    assert all(tracked.box is not None for tracked in snapshot.objects)
    marks.append(time.process_time())
    assert all(len(tracked.points_world) for tracked in snapshot.objects)
    marks.append(time.process_time())
    opened, _, known_at, records, points = np.diff(marks).tolist()
    space_seconds, found_ms = _paths(saved, places)
    began = time.process_time()
    render_map(saved, {1, 2}, _PICTURE_PX)
    return Reading(
        objects=len(saved.snapshot.objects), open_seconds=opened, known_at_seconds=known_at,
        known_records_seconds=records, known_points_seconds=points, space_seconds=space_seconds,
        path_ms=float(np.median(found_ms)) if found_ms else None, num_paths=len(found_ms),
        render_seconds=time.process_time() - began,
    )  # fmt: skip


def _paths(saved: SavedMap, places: list[np.ndarray]) -> tuple[float, list[float]]:
    began = time.process_time()
    # Space that a robot saw while it passed counts as free, so that it can be planned through.
    space = free_space_of(saved.snapshot, load_robot("point"), unknown="free")
    space_seconds = time.process_time() - began
    rng = np.random.default_rng(0)
    found_ms = []
    for i in range(_TRIES):
        a = int(rng.integers(len(places)))
        b = min(len(places) - 1, a + 40)
        started = time.process_time()
        # None where a person walked and the robot does not fit.
        path = first_path(space, places[a], places[b], np.random.default_rng(i))
        if path is not None and i:  # the first one loads kernels
            found_ms.append(1e3 * (time.process_time() - started))
    return space_seconds, found_ms
