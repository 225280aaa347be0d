"""What alignment says where it cannot know, and how well it knows how sure it is.

Places that look alike (`evaluation.maps.ambiguous`): how often an answer is wrong, and how often one is given where it
can be; the same with the furniture of worlds (`furnished_maps`). Furnished apartments without observed space: how often
two different ones are joined, and one with itself. Simulated pairs at 0 to 3 degrees of tilt: the squared error in
units of the covariance. Seeds from 0 on were tuned on; the figures are of others.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import combinations

import numpy as np

from hickory_stream.alignment.align import align
from hickory_stream.alignment.answer import Alignment
from hickory_stream.evaluation.maps.ambiguous import AmbiguousConfig, Draw, simulate_ambiguous, uniform
from hickory_stream.evaluation.maps.simulate import Difficulty, SimulationConfig, simulate_pair
from hickory_stream.evaluation.maps.trial import error_of, normalised_square, overlap_b
from tools.benchmarks.alignment.furnished_maps import furnished, shared_apartment, unrelated_apartments
from tools.benchmarks.common.figures import Figure, figure
from tools.benchmarks.common.intervals import wilson

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
_DIFFICULTIES: tuple[Difficulty, ...] = ("easy", "hard")
_CHI2_95 = 12.592
_BASE = 900_000
_FRESH = 50_000
_FIRST_APARTMENT = 500


def jobs_of_ambiguous(seed: int, trials: int) -> list[tuple[AmbiguousConfig, int]]:
    """Return the cases, each so many times, half of each difficulty; no seed was tuned on."""
    return [
        (config_of(config, _DIFFICULTIES[i % 2]), 100_000 * seed + _FRESH + i)
        for config in (*AMBIGUOUS, *DECIDABLE)
        for i in range(trials)
    ]


def config_of(config: AmbiguousConfig, difficulty: Difficulty) -> AmbiguousConfig:
    """Return a case with objects of a difficulty."""
    return replace(config, difficulty=difficulty)


def ambiguous_trial(job: tuple[AmbiguousConfig, int]) -> tuple[str, bool, bool, bool]:
    """Return the case's kind, whether it is decidable, and whether its answer is right, or wrong."""
    return _ambiguous_trial(job, uniform)


def furnished_trial(job: tuple[AmbiguousConfig, int]) -> tuple[str, bool, bool, bool]:
    """Return the same of a place with the furniture of a world."""
    return _ambiguous_trial(job, furnished)


def _ambiguous_trial(job: tuple[AmbiguousConfig, int], draw: Draw) -> tuple[str, bool, bool, bool]:
    config, seed = job
    pair = simulate_ambiguous(config, seed, draw)
    answer = align(pair.map_a, pair.map_b)
    is_answered = isinstance(answer, Alignment)
    is_right = (
        isinstance(answer, Alignment)
        and len(pair.common) > 0
        and error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)).is_success
    )
    return config.kind, config.is_decidable, is_right, is_answered and not is_right


def of_ambiguous(told: Iterable[tuple[str, bool, bool, bool]], *, suffix: str = "") -> list[Figure]:
    """Return the figures of places that look alike, in all and by kind; their names end in `suffix`."""
    told = list(told)
    figures = [
        _share(f"ambiguous_wrong_fraction{suffix}", [wrong for *_, wrong in told], "lower"),
        _share(f"decidable_success{suffix}", [right for _, decidable, right, _ in told if decidable], "higher"),
    ]
    for kind in sorted({kind for kind, *_ in told}):
        name = kind.replace("-", "_") + suffix
        figures.append(_share(f"ambiguous_wrong_{name}", [w for k, *_, w in told if k == kind], "lower"))
        rights = [right for k, decidable, right, _ in told if decidable and k == kind]
        if rights:
            figures.append(_share(f"decidable_success_{name}", rights, "higher"))
    return figures


def jobs_of_apartments(seed: int, count: int) -> list[tuple[int, int]]:
    """Return all pairs of so many apartments, each with itself too."""
    first = 1000 * seed + _FIRST_APARTMENT
    return [*combinations(range(first, first + count), 2), *((i, i) for i in range(first, first + count))]


def apartment_trial(job: tuple[int, int]) -> tuple[bool, bool, bool]:
    """Return whether two apartments are one, whether they were joined, and whether rightly."""
    is_one, difficulty = job[0] == job[1], _DIFFICULTIES[sum(job) // 2 % 2]
    pair = shared_apartment(job[0], difficulty) if is_one else unrelated_apartments(job, difficulty)
    answer = align(pair.map_a, pair.map_b)
    if not isinstance(answer, Alignment):
        return is_one, False, False
    return is_one, True, is_one and error_of(answer.a_from_b, pair.a_from_b, overlap_b(pair)).is_success


def of_apartments(told: Iterable[tuple[bool, bool, bool]]) -> list[Figure]:
    """Return how often different furnished apartments are joined, and how often one is found to be the same."""
    told = list(told)
    return [
        _share("unrelated_joined_fraction", [joined for is_one, joined, _ in told if not is_one], "lower"),
        _share("apartment_found_again", [right for is_one, _, right in told if is_one], "higher"),
    ]


def jobs_of_squares(seed: int, trials: int) -> list[tuple[SimulationConfig, int]]:
    """Return simulated pairs of every tilt, half of them with few pairs in common."""
    return [
        (SimulationConfig(outliers=(0.5, 0.75)[i % 2], tilt_deg=tilt), 100_000 * seed + _BASE + i)
        for tilt in _TILTS_DEG
        for i in range(trials)
    ]


def square_trial(job: tuple[SimulationConfig, int]) -> float | None:
    """Return the normalised squared error, None where the maps were not aligned."""
    pair = simulate_pair(*job)
    answer = align(pair.map_a, pair.map_b)
    return normalised_square(answer, pair.a_from_b) if isinstance(answer, Alignment) else None


def of_squares(squares: Iterable[float | None]) -> list[Figure]:
    """Return the mean normalised squared error, and the share within the 95 % that chi-squared has."""
    known = np.array([square for square in squares if square is not None])
    half = 1.96 * float(known.std(ddof=1)) / np.sqrt(len(known))
    mean = figure(
        "nees_mean",
        known.mean(),
        "",
        "same",
        f"{len(known)} answers, 6 dof",
        interval=(float(known.mean() - half), float(known.mean() + half)),
        interval_by="normal",
    )
    return [mean, _share("nees_within_95", [bool(square < _CHI2_95) for square in known], "higher")]


def _share(name: str, are: list[bool], better: str) -> Figure:
    return figure(
        name,
        sum(are) / len(are),
        "",
        "lower" if better == "lower" else "higher",
        f"{len(are)} trials",
        interval=wilson(sum(are), len(are)),
        interval_by="Wilson",
    )
