"""The densest set of candidate pairs that all agree with one another: CLIPPER's problem (Lusk et al., 2021).

Maximise u' M u over u >= 0 with |u| = 1, where u_c u_d = 0 for pairs c, d that contradict each other. Projected
gradient ascent, with a penalty on contradictions that grows until none is left, gives a clique of any graph. An exact
search for the maximum weight clique then starts from it, over the vertices that a heavier clique could contain. Two
pairs that share an object are never connected, so that every clique is one-to-one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from hickory_stream.alignment.clique import heaviest_clique
from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from hickory_stream.alignment.affinity import Affinity


@dataclass(frozen=True, kw_only=True, slots=True)
class ConsensusConfig(Ranged):
    """The effort of the search for the densest set.

    Attributes:
        pair_gain: weight of a pair in addition to the logarithm of its rank, for its consistency with the others.
        penalties: number of steps in which the penalty on contradictions is increased.
        ascent_steps: iterations per penalty.
        exact_nodes: nodes of the exact search; beyond them its best clique so far is taken.
    """

    pair_gain: float = number(4.0, 0, 1000, "log10")
    penalties: int = number(8, 1, 1000, "steps")
    ascent_steps: int = number(12, 1, 10_000, "iterations")
    exact_nodes: int = number(200_000, 0, 1_000_000_000, "nodes")


def densest_clique(affinity: Affinity, alive: NDArray[np.bool_], config: ConsensusConfig) -> NDArray[np.int64]:
    """Return the ascending indices of the candidates in the heaviest clique found among those `alive` (C,).

    The weight of a candidate is `pair_gain` minus the logarithm of its rank. Empty if no candidate is alive.
    """
    vertices, starts, neighbors, weights = _alive_graph(
        affinity.starts, affinity.neighbors, affinity.weights, np.ascontiguousarray(alive)
    )
    if not len(vertices):
        return np.empty(0, dtype=np.int64)
    gains = config.pair_gain - affinity.log_ranks[vertices]
    strengths = np.cbrt(gains / gains.max())
    u = _ascend(starts, neighbors, np.cbrt(weights), strengths, config.penalties, config.ascent_steps)
    clique = _rounded(starts, neighbors, np.argsort(-u, kind="stable"))
    clique = heaviest_clique(starts, neighbors, gains, clique, config.exact_nodes)
    return np.sort(vertices[clique])


def ascended_clique(
    agreement: NDArray[np.float64], strengths: NDArray[np.float64], config: ConsensusConfig
) -> NDArray[np.int64]:
    """Return the ascending indices of the clique that gradient ascent alone finds, without the exact search.

    Args:
        agreement: (C, C) symmetric weights, 0 where two candidates contradict each other.
        strengths: (C,) of the candidates, in 0..1.
        config: the numbers of steps.
    """
    rows, columns = np.nonzero(agreement)
    starts = np.searchsorted(rows, np.arange(len(strengths) + 1)).astype(np.int64)
    neighbors = columns.astype(np.int32)
    weights = agreement[rows, columns].astype(np.float32)
    u = _ascend(starts, neighbors, weights, strengths, config.penalties, config.ascent_steps)
    return np.sort(_rounded(starts, neighbors, np.argsort(-u, kind="stable")))


@kernel
def _alive_graph(starts, neighbors, weights, alive):
    """Return the graph among the candidates that are alive, renumbered."""
    vertices = np.flatnonzero(alive)
    rank = np.full(len(alive), -1, dtype=np.int32)
    rank[vertices] = np.arange(len(vertices), dtype=np.int32)
    new_starts = np.zeros(len(vertices) + 1, dtype=np.int64)
    new_neighbors = np.empty(len(neighbors), dtype=np.int32)
    new_weights = np.empty(len(weights), dtype=np.float32)
    at = 0
    for v in range(len(vertices)):
        for e in range(starts[vertices[v]], starts[vertices[v] + 1]):
            if alive[neighbors[e]]:
                new_neighbors[at] = rank[neighbors[e]]
                new_weights[at] = weights[e]
                at += 1
        new_starts[v + 1] = at
    return vertices, new_starts, new_neighbors[:at], new_weights[:at]


@kernel
def _ascend(starts, neighbors, weights, strengths, penalties, steps):
    """Return u of projected gradient ascent; M has strengths^2 on its diagonal, and weights times strengths elsewhere.

    A coordinate that has become zero stays zero, so that the problem becomes smaller with every step.
    """
    count = len(strengths)
    u = np.ones(count)
    active = np.arange(count)
    gradient = np.empty(count)
    penalty = 0.0
    for _ in range(penalties):
        value = -np.inf
        is_clique = True
        for _ in range(steps):
            total = u[active].sum()
            new_value, norm, largest = 0.0, 0.0, 0.0
            is_clique = True
            for c in active:
                pull, linked = strengths[c] ** 2 * u[c], u[c]
                for e in range(starts[c], starts[c + 1]):
                    other = u[neighbors[e]]
                    if other > 0.0:
                        pull += weights[e] * strengths[c] * strengths[neighbors[e]] * other
                        linked += other
                contradicted = total - linked
                is_clique &= contradicted <= 1e-9 * total
                gradient[c] = pull - penalty * contradicted
                new_value += u[c] * gradient[c]
                norm += u[c] * u[c]
                largest = max(largest, abs(gradient[c]))
            if largest <= 0.0:
                break
            scale = 2.0 * np.sqrt(norm) / largest
            norm = 0.0
            for c in active:
                # A coordinate with a negative gradient decreases until it is zero.
                u[c] = max(u[c] + scale * gradient[c], 0.0)
                norm += u[c] * u[c]
            if norm <= 0.0:
                break
            u[active] /= np.sqrt(norm)
            active = active[u[active] > 1e-6]
            if new_value - value < 1e-3 * abs(new_value):
                break
            value = new_value
        if is_clique:
            break
        # The penalty rises from a small value to more than any vertex can gain from all its neighbours.
        penalty = 0.02 if penalty == 0.0 else 2.0 * penalty
    return u


@kernel
def _linked(starts, neighbors, c, d):
    low, high = starts[c], starts[c + 1]
    while low < high:
        middle = (low + high) // 2
        if neighbors[middle] < d:
            low = middle + 1
        else:
            high = middle
    return low < starts[c + 1] and neighbors[low] == d


@kernel
def _rounded(starts, neighbors, order):
    """Return the clique found greedily: vertices are taken in `order` if they agree with all before them."""
    clique = np.empty(len(order), dtype=np.int64)
    size = 0
    for v in order:
        fits = True
        for k in range(size):
            if not _linked(starts, neighbors, v, clique[k]):
                fits = False
                break
        if fits:
            clique[size] = v
            size += 1
    return clique[:size].copy()
