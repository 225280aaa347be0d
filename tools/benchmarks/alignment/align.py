"""Benchmark of alignment: simulated pairs with known truth, unrelated maps, apartments, and processor time.

Simulated trials run in two processes; times are the least of three repetitions of CPU time, on the hard set. The
apartments are played once for each state of the mapper's code, into out/maps/.
"""

from __future__ import annotations

import itertools
import multiprocessing
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.alignment.methods import METHODS, Method
from hickory_stream.alignment.object_map import ObjectMap, object_map
from hickory_stream.engine.saved_map import open_map
from hickory_stream.evaluation.maps.simulate import Difficulty, SimulationConfig, simulate_pair, simulate_unrelated
from hickory_stream.evaluation.maps.trial import Trial, error_of, noise_floor, run_trial
from hickory_stream.evaluation.maps.variants import bent_map
from hickory_stream.geometry.rigid import apply, invert
from tools.benchmarks.alignment.ambiguous import (
    ambiguous_trial,
    apartment_trial,
    furnished_trial,
    jobs_of_ambiguous,
    jobs_of_apartments,
    jobs_of_squares,
    of_ambiguous,
    of_apartments,
    of_squares,
    square_trial,
)
from tools.benchmarks.common.apartment_maps import apartment_map, frame_of
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import ROOT

J, R = TypeVar("J"), TypeVar("R")
_APARTMENTS = 4
_TIMED = (40, 160, 320)
_DRIFT_DEG_PER_M = 0.3
_ABLATED: tuple[Method, ...] = ("sq", "semantic", "bbox", "sq-paper", "roman-one", "roman-xl", "ransac")


# In a process of its own that imports nothing but what is measured.
_PEAK = """
import resource, sys
from hickory_stream.alignment.align import align
from hickory_stream.evaluation.maps.simulate import SimulationConfig, simulate_pair
pair = simulate_pair(SimulationConfig(num_objects=320, difficulty="hard"), int(sys.argv[1]))
align(pair.map_a, pair.map_b)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""


# Three thousand objects in each map, of which 750 are in both: whether they are aligned, in what time and memory.
_LARGE = """
import resource, sys, time
from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.evaluation.maps.simulate import SimulationConfig, simulate_pair
from hickory_stream.evaluation.maps.trial import error_of, overlap_b
pair = simulate_pair(SimulationConfig(num_objects=3000, outliers=0.75), int(sys.argv[1]))
started = time.process_time()
answer = align(pair.map_a, pair.map_b)
seconds = time.process_time() - started
found = isinstance(answer, Alignment) and error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)).is_success
print(int(found), seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
_LARGE_TRIALS = 3


@dataclass(frozen=True, kw_only=True, slots=True)
class _Set:
    """Trials of one kind: `quick` and `full` say how many."""

    name: str
    config: SimulationConfig
    full: int
    quick: int


def _set(
    name: str, num_objects: int, outliers: float, difficulty: Difficulty, trials: tuple[int, int], tilt_deg: float = 0.0
) -> _Set:
    config = SimulationConfig(num_objects=num_objects, outliers=outliers, difficulty=difficulty, tilt_deg=tilt_deg)
    return _Set(name=name, config=config, full=trials[0], quick=trials[1])


_SETS = (
    _set("40_75", 40, 0.75, "easy", (600, 60)),
    _set("40_75_hard", 40, 0.75, "hard", (600, 60)),
    _set("40_90", 40, 0.9, "easy", (500, 60)),
    _set("40_90_hard", 40, 0.9, "hard", (500, 40)),
    _set("20_75", 20, 0.75, "easy", (600, 60)),
    _set("20_75_hard", 20, 0.75, "hard", (600, 60)),
    _set("tilt5", 40, 0.5, "easy", (200, 20), 5.0),
    _set("tilt15", 40, 0.5, "easy", (400, 40), 15.0),
    _set("tilt15_hard", 40, 0.5, "hard", (200, 20), 15.0),
)


def measure(options: Options) -> list[Figure]:
    """Return the figures; a figure that was not measured is absent."""
    figures, trials = _of_sets(options)
    figures += _of_unrelated(options)
    figures += _of_confidence(trials)
    figures += of_ambiguous(_in_processes(ambiguous_trial, jobs_of_ambiguous(options.seed, 2 if options.quick else 40)))
    worlds = _in_processes(furnished_trial, jobs_of_ambiguous(options.seed, 1 if options.quick else 10))
    figures += of_ambiguous(worlds, suffix="_worlds")
    apartments = jobs_of_apartments(options.seed, 6 if options.quick else 40)
    figures += of_apartments(_in_processes(apartment_trial, apartments))
    figures += of_squares(_in_processes(square_trial, jobs_of_squares(options.seed, 8 if options.quick else 100)))
    figures += _of_times(options)
    figures += _of_ablation(options)
    figures += _of_apartments(options)
    return figures


# ---- simulated maps -------------------------------------------------------------------------------------------------


def _of_sets(options: Options) -> tuple[list[Figure], list[Trial]]:
    figures, every = [], []
    for one in _SETS:
        trials = _run(one.config, one.quick if options.quick else one.full, options.seed, "sq")
        every += trials
        print(f"{one.name}: {_summary(trials)}", flush=True)
        figures.append(figure(f"success_{one.name}", _share(trials), "", "higher"))
        if one.name in ("40_75", "40_75_hard"):
            errors = [trial.error for trial in trials if trial.error is not None and trial.error.is_success]
            floors = [noise_floor(one.config, _seed(options.seed, i)) for i in range(20)]
            figures += [
                figure(f"error_{one.name}_m", np.median([e.translation_m for e in errors]), "m", "lower"),
                figure(f"error_{one.name}_origin_m", np.median([e.origin_m for e in errors]), "m", "lower"),
                figure(f"error_{one.name}_deg", np.median([e.rotation_deg for e in errors]), "deg", "lower"),
                figure(f"floor_{one.name}_m", np.median([floor[0] for floor in floors]), "m", "lower"),
                figure(f"floor_{one.name}_deg", np.median([floor[1] for floor in floors]), "deg", "lower"),
            ]
    return [figure("trials", len(every), "", "higher"), *figures], every


def _of_confidence(trials: list[Trial]) -> list[Figure]:
    """Return how many answers were given, and which share of them was wrong."""
    answers = [trial for trial in trials if trial.error is not None]
    wrong = sum(trial.is_wrong for trial in answers)
    return [
        figure("confident_answers", len(answers), "", "higher"),
        figure("wrong_confident_fraction", wrong / max(len(answers), 1), "", "lower"),
    ]


def _of_ablation(options: Options) -> list[Figure]:
    """Return how often each method is right and wrong on the hard set, and on two that are harder still."""
    count = 10 if options.quick else 200
    figures = []
    for name, config in (
        ("hard", SimulationConfig(num_objects=40, outliers=0.75, difficulty="hard")),
        ("hard_20", SimulationConfig(num_objects=20, outliers=0.75, difficulty="hard")),
        ("hard_90", SimulationConfig(num_objects=40, outliers=0.9, difficulty="hard")),
    ):
        for method in _ABLATED:
            trials = _run(config, count, options.seed, method)
            label = f"{method.replace('-', '_')}_{name}"
            print(f"ablation {label}: {_summary(trials)}", flush=True)
            figures.append(figure(f"ablation_{label}_success", _share(trials), "", "higher"))
            wrong = sum(trial.is_wrong for trial in trials) / len(trials)
            figures.append(figure(f"ablation_{label}_wrong", wrong, "", "lower"))
    return figures


def _run(config: SimulationConfig, count: int, seed: int, method: Method) -> list[Trial]:
    jobs = [(config, _seed(seed, i), method) for i in range(count)]
    return _in_processes(_trial, jobs)


def _trial(job: tuple[SimulationConfig, int, Method]) -> Trial:
    return run_trial(*job)


def _of_unrelated(options: Options) -> list[Figure]:
    count = 60 if options.quick else 1000
    kinds: list[tuple[int, Difficulty]] = [(20, "easy"), (20, "hard"), (40, "easy"), (40, "hard")]
    jobs = [
        (SimulationConfig(num_objects=kinds[i % 4][0], difficulty=kinds[i % 4][1]), _seed(options.seed, 50_000 + i))
        for i in range(count)
    ]
    accepted = sum(_in_processes(_is_accepted, jobs))
    maps = _apartment_maps(options)
    different = [(maps[a][w], maps[b][v]) for a, b in itertools.combinations(maps, 2) for w in (0, 1) for v in (0, 1)]
    accepted += sum(isinstance(align(one, other), Alignment) for one, other in different)
    print(f"unrelated: {count} simulated and {len(different)} of apartments, {accepted} accepted", flush=True)
    return [
        figure("non_overlapping_pairs", count + len(different), "", "higher"),
        figure("false_accepts", accepted, "", "lower"),
    ]


def _is_accepted(job: tuple[SimulationConfig, int]) -> bool:
    pair = simulate_unrelated(*job)
    return isinstance(align(pair.map_a, pair.map_b), Alignment)


@cache
def _pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


def _in_processes(function: Callable[[J], R], jobs: Sequence[J]) -> list[R]:
    return list(_pool().map(function, jobs, chunksize=max(len(jobs) // 16, 1)))


# ---- time and memory ------------------------------------------------------------------------------------------------


def _of_times(options: Options) -> list[Figure]:
    figures = []
    for size in _TIMED:
        seconds = [_seconds(size, _seed(options.seed, i)) for i in range(2 if options.quick else 5)]
        figures.append(figure(f"seconds_{size}", float(np.median(seconds)), "s", "lower"))
    told = subprocess.run(
        [sys.executable, "-c", _PEAK, str(_seed(options.seed, 0))], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout
    figures.append(figure("rss_320_mb", float(told), "MB", "lower"))
    return figures if options.quick else [*figures, *_of_large_maps(options)]


def _of_large_maps(options: Options) -> list[Figure]:
    """Return how often maps of 3,000 objects are aligned, and the most processor time and memory that it took."""
    told = [
        subprocess.run(
            [sys.executable, "-c", _LARGE, str(_seed(options.seed, i))],
            cwd=ROOT,
            check=True,
            capture_output=True,
            text=True,
        ).stdout.split()
        for i in range(_LARGE_TRIALS)
    ]
    found, seconds, megabytes = zip(*told, strict=True)
    return [
        figure("align_3000_success", np.mean([int(one) for one in found]), "", "higher"),
        figure("align_3000_seconds", max(float(one) for one in seconds), "s", "lower"),
        figure("align_3000_rss_mb", max(float(one) for one in megabytes), "MB", "lower"),
    ]


def _seconds(size: int, seed: int) -> float:
    """Return the CPU seconds of one alignment of hard maps, scores included: the least of three."""
    pair = simulate_pair(SimulationConfig(num_objects=size, difficulty="hard"), seed)
    taken = []
    for _ in range(3):
        started = time.process_time()
        align(pair.map_a, pair.map_b)
        taken.append(time.process_time() - started)
    return min(taken)


# ---- apartments -----------------------------------------------------------------------------------------------------


def _of_apartments(options: Options) -> list[Figure]:
    """Return the mean error over the apartments, each mapped twice, the second map in a frame of its own."""
    maps = _apartment_maps(options)
    errors, found = [], 0
    for apartment, (map_a, map_b) in maps.items():
        b_from_world = frame_of(apartment, 1)
        answer = align(map_a, map_b)
        if not isinstance(answer, Alignment):
            print(f"apartment {apartment}: refused, {answer.reason}", flush=True)
            continue
        center_b = apply(b_from_world, answer.center_a)
        error = error_of(answer.a_from_b, invert(b_from_world), center_b)
        found += error.is_success
        errors.append(error)
        print(
            f"apartment {apartment}: {len(answer.pairs)} pairs, {error.translation_m:.4f} m, "
            f"{error.rotation_deg:.3f} deg, chance 10^{answer.log10_chance:.0f}",
            flush=True,
        )
    if not maps:
        return []
    bent = [align(map_a, bent_map(map_b, _DRIFT_DEG_PER_M)) for map_a, map_b in maps.values()]
    figures = [
        figure("apartments_found", found, "", "higher"),
        figure("apartments_found_drifting", sum(isinstance(one, Alignment) for one in bent), "", "higher"),
    ]
    if errors:
        figures += [
            figure("apartments_trans_m", np.mean([e.translation_m for e in errors]), "m", "lower"),
            figure("apartments_rot_deg", np.mean([e.rotation_deg for e in errors]), "deg", "lower"),
        ]
    return figures


_kept: dict[int, tuple[ObjectMap, ObjectMap]] = {}


def _apartment_maps(options: Options) -> dict[int, tuple[ObjectMap, ObjectMap]]:
    """Return the two maps of each apartment; a quick run takes those that are there and plays nothing."""
    base = 1000 + 10 * options.seed
    for apartment in range(base, base + _APARTMENTS):
        folders = [apartment_map(apartment, walk, plays=not options.quick) for walk in (0, 1)]
        if apartment not in _kept and all(folder is not None for folder in folders):
            one, other = (object_map(open_map(folder).snapshot) for folder in folders if folder is not None)
            _kept[apartment] = (one, other)
    return _kept


# ---- figures --------------------------------------------------------------------------------------------------------


def _seed(seed: int, index: int) -> int:
    return 100_000 * seed + index


def _share(trials: list[Trial]) -> float:
    return sum(trial.is_success for trial in trials) / len(trials)


def _summary(trials: list[Trial]) -> str:
    wrong = sum(trial.is_wrong for trial in trials)
    reasons: dict[str, int] = {}
    for trial in trials:
        if trial.refusal is not None:
            reasons[trial.refusal] = reasons.get(trial.refusal, 0) + 1
    told = ", ".join(f"{count} {reason}" for reason, count in sorted(reasons.items())) or "none"
    return f"{len(trials)} trials, success {_share(trials):.3f}, wrong {wrong}, refused: {told}"


assert set(_ABLATED) <= set(METHODS)
