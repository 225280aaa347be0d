"""Alignment of maps: simulated pairs with known truth, unrelated maps, apartments, and processor time."""
# Simulated trials run in two processes; times are the least of three repetitions of CPU time, on the hard set. The
# apartments, in a whole run alone, are played once for each state of the mapper's code, into out/maps/.

import itertools
import multiprocessing
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from typing import Any, TypeVar

import numpy as np

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.alignment.object_map import ObjectMap, object_map
from hickory_stream.geometry.rigid import apply, invert
from hickory_stream.map_folder.saved_map import open_map
from tools.benchmarks.alignment.ambiguous import ambiguous_figures
from tools.benchmarks.alignment.large_pair import large_pair
from tools.benchmarks.common.cached_runs import apartment_map, frame_of
from tools.benchmarks.common.figures import Figure, Options, figure
from tools.benchmarks.common.processes import best_s
from tools.evaluation.alignment_error import error_of
from tools.evaluation.simulated_maps.simulate import Difficulty, SimulationConfig, simulate_pair, simulate_unrelated
from tools.evaluation.simulated_maps.trial import Trial, noise_floor, run_trial

R = TypeVar("R")
_APARTMENTS = 4
_TIMED = (40, 160, 320)


def _set(num_objects: int, outliers: float, difficulty: Difficulty = "easy", tilt_deg: float = 0.0) -> SimulationConfig:
    return SimulationConfig(num_objects=num_objects, outliers=outliers, difficulty=difficulty, tilt_deg=tilt_deg)


# Trials of each kind, and how many of a whole and of a quick run.
_SETS = {
    "40_75": (_set(40, 0.75), 600, 60), "40_75_hard": (_set(40, 0.75, "hard"), 600, 60),
    "40_90": (_set(40, 0.9), 500, 60), "40_90_hard": (_set(40, 0.9, "hard"), 500, 40),
    "20_75": (_set(20, 0.75), 600, 60), "20_75_hard": (_set(20, 0.75, "hard"), 600, 60),
    "tilt5": (_set(40, 0.5, "easy", 5.0), 200, 20), "tilt15": (_set(40, 0.5, "easy", 15.0), 400, 40),
    "tilt15_hard": (_set(40, 0.5, "hard", 15.0), 200, 20),
}  # fmt: skip


def measure(options: Options) -> list[Figure]:
    """Return the figures; a quick run takes fewer trials, and no apartments."""
    maps = {} if options.quick else _apartment_maps(options.seed)
    figures, trials = _of_sets(options)
    figures += _of_unrelated(options, maps)
    figures += _of_confidence(trials)
    figures += ambiguous_figures(options, _in_processes)
    figures += _of_times(options)
    return figures + (_of_apartments(maps) if maps else [])


def _of_sets(options: Options) -> tuple[list[Figure], list[Trial]]:
    figures, every = [], []
    for name, (config, full, quick) in _SETS.items():
        jobs = [(config, _seed(options.seed, i)) for i in range(quick if options.quick else full)]
        trials = _in_processes(run_trial, jobs)
        every += trials
        print(f"{name}: {_summary(trials)}", flush=True)
        figures.append(figure(f"success_{name}", _share(trials)))
        if name in ("40_75", "40_75_hard"):
            errors = [trial.error for trial in trials if trial.error is not None and trial.error.is_success]
            floor = np.median([noise_floor(config, _seed(options.seed, i)) for i in range(20)], axis=0)
            for suffix, value, unit in (
                ("error_{}_m", np.median([e.translation_m for e in errors]), "m"),
                ("error_{}_origin_m", np.median([e.origin_m for e in errors]), "m"),
                ("error_{}_deg", np.median([e.rotation_deg for e in errors]), "deg"),
                ("floor_{}_m", floor[0], "m"),
                ("floor_{}_deg", floor[1], "deg"),
            ):
                figures.append(figure(suffix.format(name), value, unit, "lower"))
    return [figure("trials", len(every)), *figures], every


def _of_confidence(trials: list[Trial]) -> list[Figure]:
    answers = [trial for trial in trials if trial.error is not None]
    wrong = sum(trial.is_wrong for trial in answers) / max(len(answers), 1)
    return [figure("confident_answers", len(answers)), figure("wrong_confident_fraction", wrong, "", "lower")]


def _of_unrelated(options: Options, maps: dict[int, tuple[ObjectMap, ObjectMap]]) -> list[Figure]:
    count = 60 if options.quick else 1000
    kinds: list[tuple[int, Difficulty]] = [(20, "easy"), (20, "hard"), (40, "easy"), (40, "hard")]
    jobs = [
        (SimulationConfig(num_objects=kinds[i % 4][0], difficulty=kinds[i % 4][1]), _seed(options.seed, 50_000 + i))
        for i in range(count)
    ]
    accepted = sum(_in_processes(_is_accepted, jobs))
    different = [pair for a, b in itertools.combinations(maps, 2) for pair in itertools.product(maps[a], maps[b])]
    accepted += sum(isinstance(align(one, other), Alignment) for one, other in different)
    print(f"unrelated: {count} simulated and {len(different)} of apartments, {accepted} accepted", flush=True)
    return [figure("non_overlapping_pairs", count + len(different)), figure("false_accepts", accepted, "", "lower")]


def _is_accepted(config: SimulationConfig, seed: int) -> bool:
    pair = simulate_unrelated(config, seed)
    return isinstance(align(pair.map_a, pair.map_b), Alignment)


@cache
def _pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


def _in_processes(function: Callable[..., R], jobs: Sequence[tuple[Any, ...]]) -> list[R]:
    return list(_pool().map(function, *zip(*jobs, strict=True), chunksize=max(len(jobs) // 16, 1)))


def _of_times(options: Options) -> list[Figure]:
    figures = []
    for size in _TIMED:
        seconds = [_seconds(size, _seed(options.seed, i)) for i in range(2 if options.quick else 5)]
        figures.append(figure(f"seconds_{size}", np.median(seconds), "s", "lower"))
    peak_mb = large_pair(_seed(options.seed, 0), 320, "hard").peak_mb
    return [*figures, figure("rss_320_mb", peak_mb, "MB", "lower")]


def _seconds(size: int, seed: int) -> float:
    pair = simulate_pair(SimulationConfig(num_objects=size, difficulty="hard"), seed)
    return best_s(lambda: align(pair.map_a, pair.map_b), 3)


def _of_apartments(maps: dict[int, tuple[ObjectMap, ObjectMap]]) -> list[Figure]:
    errors = []
    for apartment, (map_a, map_b) in maps.items():
        b_from_world = frame_of(apartment, 1)
        answer = align(map_a, map_b)
        if not isinstance(answer, Alignment):
            print(f"apartment {apartment}: refused, {answer.reason}", flush=True)
            continue
        error = error_of(answer.a_from_b, invert(b_from_world), apply(b_from_world, answer.center_a))
        errors.append(error)
        print(
            f"apartment {apartment}: {len(answer.pairs)} pairs, {error.translation_m:.4f} m, "
            f"{error.rotation_deg:.3f} deg, chance 10^{answer.log10_chance:.0f}",
            flush=True,
        )
    figures = [figure("apartments_found", sum(error.is_success for error in errors))]
    if errors:
        figures += [
            figure("apartments_trans_m", np.mean([e.translation_m for e in errors]), "m", "lower"),
            figure("apartments_rot_deg", np.mean([e.rotation_deg for e in errors]), "deg", "lower"),
        ]
    return figures


def _apartment_maps(seed: int) -> dict[int, tuple[ObjectMap, ObjectMap]]:
    base = 1000 + 10 * seed
    maps = {}
    for apartment in range(base, base + _APARTMENTS):
        one, other = (object_map(open_map(apartment_map(apartment, walk)).snapshot) for walk in (0, 1))
        maps[apartment] = one, other
    return maps


def _seed(seed: int, index: int) -> int:
    return 100_000 * seed + index


def _share(trials: list[Trial]) -> float:
    return sum(trial.is_success for trial in trials) / len(trials)


def _summary(trials: list[Trial]) -> str:
    wrong = sum(trial.is_wrong for trial in trials)
    refusals = Counter(trial.refusal for trial in trials if trial.refusal is not None)
    refused = ", ".join(f"{count} {reason}" for reason, count in sorted(refusals.items())) or "none"
    return f"{len(trials)} trials, success {_share(trials):.3f}, wrong {wrong}, refused: {refused}"
