"""A transform between two maps, the pairs of objects that it explains, and its expected number of false alarms."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from hickory_stream.alignment.acceptance import Chance, log_expected_sets
from hickory_stream.alignment.grouping import log_prices
from hickory_stream.alignment.registration import registered
from hickory_stream.geometry.arrays import freeze, freeze_all
from hickory_stream.geometry.rigid import apply

_ROUNDS = 8
_FAR = 1e6


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Hypothesis:
    """A transform between two maps with its pairs of objects."""

    a_from_b: NDArray[np.float64]
    #: (K, 2) indices into the maps, most certain first
    pairs: NDArray[np.int64]
    log_ranks: NDArray[np.float64]
    residuals_m: NDArray[np.float64]
    #: log10 of the expected number of sets between unrelated maps as good as the best of these pairs
    log10_chance: float
    #: the same where nothing stands in groups
    log10_uniform: float
    is_level: bool

    def __post_init__(self) -> None:
        freeze(self, "a_from_b", np.float64, (4, 4))
        freeze(self, "pairs", np.int64, (None, 2))
        freeze_all(self, np.float64, log_ranks=(len(self.pairs),), residuals_m=(len(self.pairs),))


@dataclass(frozen=True, kw_only=True, slots=True, eq=False)
class Evidence:
    """The data for judging hypotheses: the centroids of both maps, the ranks (N, M) of pairs, the chance model."""

    centroids_a: NDArray[np.float64]
    centroids_b: NDArray[np.float64]
    log_ranks: NDArray[np.float64]
    #: (N, M), by which candidates are chosen and weighted
    search_log_ranks: NDArray[np.float64]
    #: (P, 2) pairs similar enough to be matched
    plausible: NDArray[np.int64]
    #: standard deviation of a residual on each axis
    sigma_m: float
    #: the largest residual in multiples of `sigma_m`
    gate: float
    chance: Chance
    #: (N,) and (M,) `log_densities_of` both maps
    log_densities: tuple[NDArray[np.float64], NDArray[np.float64]]
    #: the scores (N, M) behind the ranks, NaN if unknown
    looks: tuple[NDArray[np.float64], ...] = ()


def grown(evidence: Evidence, pairs: NDArray[np.int64], *, is_level: bool) -> Hypothesis | None:
    """Return the hypothesis grown from `pairs` (K, 2) by fitting and matching in turn; None below two pairs."""
    for _ in range(_ROUNDS):
        a_from_b = _fitted(evidence, pairs, is_level)
        explained = matched(evidence, a_from_b)
        if len(explained) < 2:
            return None
        if np.array_equal(explained, pairs):
            break
        pairs = explained
    a_from_b = _fitted(evidence, pairs, is_level)
    return judged(evidence, a_from_b, pairs, is_level=is_level)


def _fitted(evidence: Evidence, pairs: NDArray[np.int64], is_level: bool) -> NDArray[np.float64]:
    points_a, points_b = evidence.centroids_a[pairs[:, 0]], evidence.centroids_b[pairs[:, 1]]
    return registered(points_a, points_b, np.ones(len(pairs)), is_level=is_level)


def matched(evidence: Evidence, a_from_b: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the pairs (K, 2), in ascending order, that agree with a transform: the optimal one-to-one assignment."""
    moved = apply(a_from_b, evidence.centroids_b)
    offsets = evidence.centroids_a[evidence.plausible[:, 0]] - moved[evidence.plausible[:, 1]]
    squares = np.einsum("kc,kc->k", offsets, offsets) / evidence.sigma_m**2
    fits = np.flatnonzero(squares < evidence.gate**2)
    pairs = evidence.plausible[fits]
    costs = squares[fits] / 2 + evidence.log_ranks[pairs[:, 0], pairs[:, 1]]
    rows, row_of = np.unique(pairs[:, 0], return_inverse=True)
    columns, column_of = np.unique(pairs[:, 1], return_inverse=True)
    if len(rows) == len(columns) == len(pairs):
        return pairs
    # The largest number of pairs, at the least cost.
    table = np.zeros((len(rows), len(columns)))
    table[row_of, column_of] = costs - _FAR
    chosen_rows, chosen_columns = linear_sum_assignment(table)
    is_pair = table[chosen_rows, chosen_columns] < 0
    return np.stack([rows[chosen_rows[is_pair]], columns[chosen_columns[is_pair]]], axis=1)


def judged(
    evidence: Evidence, a_from_b: NDArray[np.float64], pairs: NDArray[np.int64], *, is_level: bool
) -> Hypothesis:
    """Return the hypothesis of a transform and its pairs (K, 2), K >= 1."""
    points_a = evidence.centroids_a[pairs[:, 0]]
    residuals = points_a - apply(a_from_b, evidence.centroids_b[pairs[:, 1]])
    squares = (residuals**2).sum(axis=1)
    ranks = evidence.log_ranks[pairs[:, 0], pairs[:, 1]]
    # Most certain first: for every k, the best k pairs are tested.
    order = np.lexsort((pairs[:, 0], squares / (2 * evidence.sigma_m**2) + ranks))
    pairs, squares, ranks, points_a = pairs[order], squares[order], ranks[order], points_a[order]
    logs = log_expected_sets(evidence.chance, ranks, np.cumsum(squares), _running_scatters(points_a), is_level=is_level)
    chance, (of_a, of_b) = evidence.chance, evidence.log_densities
    densities = (of_a[pairs[:, 0]] + of_b[pairs[:, 1]]) / 2
    grouped = logs + log_prices(points_a, ranks, densities, chance.grouped, chance.volume_m3)
    best = int(np.argmin(grouped))
    return Hypothesis(
        a_from_b=a_from_b,
        pairs=pairs,
        log_ranks=ranks,
        residuals_m=np.sqrt(squares),
        log10_chance=float(grouped[best] / np.log(10.0)),
        log10_uniform=float(logs.min() / np.log(10.0)),
        is_level=is_level,
    )


def _running_scatters(points: NDArray[np.float64]) -> NDArray[np.float64]:
    # (K, 3, 3): sums of outer products of the first k points about their mean.
    k = np.arange(1, len(points) + 1)
    offsets = points - points.mean(axis=0)
    products = np.cumsum(offsets[:, :, None] * offsets[:, None], axis=0)
    means = np.cumsum(offsets, axis=0) / k[:, None]
    return np.asarray(products - k[:, None, None] * means[:, :, None] * means[:, None])
