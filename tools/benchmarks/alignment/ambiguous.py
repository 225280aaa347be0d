"""Answers of alignment where it cannot know, and the calibration of its covariance."""
# Shares of wrong answers, and of answers given where one can be. Seeds from 0 on were tuned on; figures are of others.

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from tools.benchmarks.common.figures import Figure, Options, figure, share
from tools.evaluation.alignment_error import error_of
from tools.evaluation.simulated_maps.ambiguous import AmbiguousConfig, Draw, simulate_ambiguous, uniform
from tools.evaluation.simulated_maps.furnished import furnished, shared_apartment, unrelated_apartments
from tools.evaluation.simulated_maps.simulate import Difficulty, SimulatedPair, SimulationConfig, simulate_pair
from tools.evaluation.simulated_maps.trial import normalised_square, overlap_b

AMBIGUOUS = (
    *(AmbiguousConfig(kind="symmetric", order=order, num_objects=n) for order in (2, 4) for n in (24, 60)),
    AmbiguousConfig(kind="repeated"),
    *(AmbiguousConfig(kind="identical-rooms", num_objects=n, jitter_m=jitter) for n in (10, 20) for jitter in (0, 0.1)),
)
DECIDABLE = (
    *(AmbiguousConfig(kind="symmetric", order=order, breaking=b) for order in (2, 4) for b in (2, 3)),
    AmbiguousConfig(kind="repeated", breaking=3),
    *(AmbiguousConfig(kind="identical-rooms", num_objects=10, breaking=b) for b in (2, 3)),
    *(AmbiguousConfig(kind="different-rooms", num_objects=10, num_rooms=n) for n in (2, 3)),
)
_TILTS_DEG = (0.0, 0.5, 1.0, 2.0, 3.0)
_CHI2_95 = 12.592
_DIFFICULTIES: tuple[Difficulty, ...] = ("easy", "hard")
_BASE = 900_000
_FRESH = 50_000
_FIRST_APARTMENT = 500

AmbiguousTrial = tuple[str, bool, bool, bool]
"""The kind of a place, whether it is decidable, and whether its answer is right, or wrong."""


def ambiguous_figures(options: Options, in_processes: Any) -> list[Figure]:
    """Return the figures; `in_processes` maps a function over jobs in other processes."""
    quick, seed = options.quick, options.seed
    figures = _of_places(in_processes(_ambiguous_trial, _places(seed, 2 if quick else 40)), "")
    figures += _of_places(
        in_processes(partial(_ambiguous_trial, draw=furnished), _places(seed, 1 if quick else 10)), "_worlds"
    )
    first, count = 1000 * seed + _FIRST_APARTMENT, 6 if quick else 40
    seeds = range(first, first + count)
    figures += _of_apartments(in_processes(_apartment_trial, [*combinations(seeds, 2), *((i, i) for i in seeds)]))
    pairs = [
        (SimulationConfig(outliers=(0.5, 0.75)[i % 2], tilt_deg=tilt), 100_000 * seed + _BASE + i)
        for tilt in _TILTS_DEG
        for i in range(8 if quick else 100)
    ]
    return figures + _of_squares(in_processes(_square_trial, pairs))


def _places(seed: int, trials: int) -> list[tuple[AmbiguousConfig, int]]:
    return [
        (replace(config, difficulty=_DIFFICULTIES[i % 2]), 100_000 * seed + _FRESH + i)
        for config in (*AMBIGUOUS, *DECIDABLE)
        for i in range(trials)
    ]


def _ambiguous_trial(config: AmbiguousConfig, seed: int, draw: Draw = uniform) -> AmbiguousTrial:
    pair = simulate_ambiguous(config, seed, draw)
    answer = align(pair.map_a, pair.map_b)
    is_right = len(pair.common) > 0 and _is_right(answer, pair)
    return config.kind, config.is_decidable, is_right, isinstance(answer, Alignment) and not is_right


def _is_right(answer: object, pair: SimulatedPair) -> bool:
    return isinstance(answer, Alignment) and error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)).is_success


def _of_places(trials: Iterable[AmbiguousTrial], suffix: str) -> list[Figure]:
    trials = list(trials)
    decided = [trial for trial in trials if trial[1]]

    def wrong(name: str, chosen: list[AmbiguousTrial]) -> list[Figure]:
        return share(name, sum(trial[3] for trial in chosen), len(chosen), "trials", "lower")

    def success(name: str, chosen: list[AmbiguousTrial]) -> list[Figure]:
        return share(name, sum(trial[2] for trial in chosen), len(chosen), "trials")

    figures = wrong(f"ambiguous_wrong_fraction{suffix}", trials) + success(f"decidable_success{suffix}", decided)
    for kind in sorted({trial[0] for trial in trials}):
        name = kind.replace("-", "_") + suffix
        figures += wrong(f"ambiguous_wrong_{name}", [trial for trial in trials if trial[0] == kind])
        figures += success(f"decidable_success_{name}", [trial for trial in decided if trial[0] == kind])
    return figures


def _apartment_trial(one: int, other: int) -> tuple[bool, bool, bool]:
    is_one, difficulty = one == other, _DIFFICULTIES[(one + other) // 2 % 2]
    pair = shared_apartment(one, difficulty) if is_one else unrelated_apartments((one, other), difficulty)
    answer = align(pair.map_a, pair.map_b)
    return is_one, isinstance(answer, Alignment), is_one and _is_right(answer, pair)


def _of_apartments(trials: Iterable[tuple[bool, bool, bool]]) -> list[Figure]:
    trials = list(trials)
    joined = [is_joined for is_one, is_joined, _ in trials if not is_one]
    right = [is_right for is_one, _, is_right in trials if is_one]
    return [
        *share("unrelated_joined_fraction", sum(joined), len(joined), "trials", "lower"),
        *share("apartment_found_again", sum(right), len(right), "trials"),
    ]


def _square_trial(config: SimulationConfig, seed: int) -> float | None:
    pair = simulate_pair(config, seed)
    answer = align(pair.map_a, pair.map_b)
    return normalised_square(answer, pair.a_from_b) if isinstance(answer, Alignment) else None


def _of_squares(squares: Iterable[float | None]) -> list[Figure]:
    known = np.array([square for square in squares if square is not None])
    half = 1.96 * float(known.std(ddof=1)) / np.sqrt(len(known))
    interval, of = (float(known.mean() - half), float(known.mean() + half)), f"{len(known)} answers, 6 dof"
    return [
        figure("nees_mean", known.mean(), "", "same", of, interval=interval, interval_by="normal"),
        *share("nees_within_95", (known < _CHI2_95).sum(), len(known), "trials"),
    ]
