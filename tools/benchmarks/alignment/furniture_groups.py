"""What `alignment/grouping.py` holds of furnished places: measured on apartments that share nothing.

    python -m tools.benchmarks.alignment.furniture_groups [--apartments 32] [--pairs 100]

The pair correlation of coincidences: of two pairs of objects that look alike, one of them d metres from the other in
the first apartment, how densely, per cubic metre, the other stands in the second one where the distance and the height
between them are the same. And how many objects are near one another,
in units of how many are further off, in furnished and in uniform places.
"""

import argparse
from collections.abc import Iterable
from itertools import combinations, pairwise

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.align import evidence_of
from hickory_stream.alignment.config import AlignConfig
from hickory_stream.alignment.grouping import crowding
from hickory_stream.alignment.shape_scores import superquadric_scores
from tools.evaluation.simulated_maps.furnished import unrelated_apartments
from tools.evaluation.simulated_maps.simulate import SimulatedPair, SimulationConfig, simulate_pair

_EDGES_M = np.array([0.0, 0.35, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0])
_SHARES = (0.01, 0.02, 0.05, 0.1, 0.25)
_REACH_M = 0.15
_MOST_PAIRS = 400


def pair_correlation(pairs: Iterable[SimulatedPair], share: float) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return (B,) how densely, per cubic metre, another pair coincides beside one, by distance, and how many did."""
    # pairs: maps of places that share nothing.
    # share: this share of all pairs of objects counts, the most similar ones.
    observed, tried_m3 = np.zeros(len(_EDGES_M) - 1), np.zeros(len(_EDGES_M) - 1)
    config = AlignConfig()
    for pair in pairs:
        evidence, _ = evidence_of(pair.map_a, pair.map_b, config, superquadric_scores)
        alike = np.argwhere(evidence.log_ranks <= np.log(share))[:_MOST_PAIRS]
        i, j = np.triu_indices(len(alike), 1)
        differ = (alike[i, 0] != alike[j, 0]) & (alike[i, 1] != alike[j, 1])
        i, j = i[differ], j[differ]
        steps_a, steps_b = (
            points[alike[j, side]] - points[alike[i, side]]
            for side, points in enumerate((evidence.centroids_a, evidence.centroids_b))
        )
        level_a, level_b = np.hypot(*steps_a[:, :2].T), np.hypot(*steps_b[:, :2].T)
        agree = (np.abs(level_a - level_b) < _REACH_M) & (np.abs(steps_a[:, 2] - steps_b[:, 2]) < _REACH_M)
        ring_m2 = np.pi * ((level_a + _REACH_M) ** 2 - np.maximum(level_a - _REACH_M, 0.0) ** 2)
        observed += np.histogram(level_a[agree], _EDGES_M)[0]
        tried_m3 += np.histogram(level_a, _EDGES_M, weights=ring_m2 * 2 * _REACH_M)[0]
    return observed / np.maximum(tried_m3, 1e-9), observed.astype(np.int64)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--apartments", type=int, default=32)
    parser.add_argument("--pairs", type=int, default=100)
    options = parser.parse_args()
    seeds = list(combinations(range(options.apartments), 2))
    chosen = np.random.default_rng(2).permutation(len(seeds))[: options.pairs]
    furnished = [unrelated_apartments(seeds[k], "hard" if n % 2 else "easy") for n, k in enumerate(chosen)]
    print("distance of", *(f"{low:.2f}-{high:.2f}" for low, high in pairwise(_EDGES_M)), "m")
    for share in _SHARES:
        rows = zip(*pair_correlation(furnished, share), strict=True)
        print(f"best {share:.2f}:", *(f"{density:.3f} ({count})" for density, count in rows))
    uniform = [simulate_pair(SimulationConfig(num_objects=20 + 20 * (n % 2)), n) for n in range(60)]
    for name, pairs in (("furnished", furnished), ("uniform", uniform)):
        counts = np.array([crowding(one.centroids) for pair in pairs for one in (pair.map_a, pair.map_b)])
        low, middle, high = np.quantile((counts[:, 0] + 1) / (counts[:, 1] + 1), [0.05, 0.5, 0.95])
        print(f"{name}: {middle:.2f} times as many near as further off (5 to 95 %: {low:.2f} to {high:.2f})")


if __name__ == "__main__":
    main()
