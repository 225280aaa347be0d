"""The densest set of candidate pairs that all agree with one another: CLIPPER's problem (Lusk et al., 2021).

Maximise u' M u over u >= 0 with |u| = 1, where u_c u_d = 0 for pairs c, d that contradict each other. Projected
gradient ascent, with a penalty on contradictions that grows until none is left, gives a clique of any graph. An exact
search for the maximum weight clique then starts from it, over the vertices that a heavier clique could contain. Two
pairs that share an object are never connected, so that every clique is one-to-one.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hickory_stream.alignment.affinity import Affinity
from hickory_stream.base.compiled import kernel
from hickory_stream.base.ranges import Ranged, number


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
    """Return ascending indices of the heaviest clique of `alive` (C,) candidates, weights `pair_gain` - log rank."""
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

    `agreement` (C, C) is symmetric, 0 where two candidates contradict each other; `strengths` (C,) are in 0..1.
    """
    rows, columns = np.nonzero(agreement)
    starts = np.searchsorted(rows, np.arange(len(strengths) + 1)).astype(np.int64)
    neighbors = columns.astype(np.int32)
    weights = agreement[rows, columns].astype(np.float32)
    u = _ascend(starts, neighbors, weights, strengths, config.penalties, config.ascent_steps)
    return np.sort(_rounded(starts, neighbors, np.argsort(-u, kind="stable")))


@kernel
def _alive_graph(starts, neighbors, weights, alive):
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
    # M has strengths^2 on its diagonal, weights times strengths elsewhere. A coordinate that is zero stays zero.
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
    # Greedy: vertices in `order` that agree with all before them.
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


@kernel
def heaviest_clique(starts, neighbors, gains, incumbent, max_nodes):
    """Return the vertices of the clique with the greatest total gain, or the best one found in `max_nodes` nodes."""
    # Compressed rows, neighbours ascending; `gains` (C,) are positive; `incumbent` is a clique to beat.
    best = incumbent
    best_gain = gains[incumbent].sum()
    order, position = _smallest_last(starts, neighbors)
    place = np.full(len(order), -1, dtype=np.int64)
    nodes = 0
    for i in range(len(order) - 1, -1, -1):
        root = order[i]
        later = np.empty(starts[root + 1] - starts[root], dtype=np.int64)
        size = 0
        possible = gains[root]
        for e in range(starts[root], starts[root + 1]):
            if position[neighbors[e]] > i:
                later[size] = neighbors[e]
                possible += gains[neighbors[e]]
                size += 1
        if possible <= best_gain:
            continue
        if size == 0:
            best, best_gain = np.array([root]), gains[root]
            continue
        later = later[:size]
        linked = np.zeros((size, size), dtype=np.bool_)
        for p in range(size):
            place[later[p]] = p
        for p in range(size):
            for e in range(starts[later[p]], starts[later[p] + 1]):
                q = place[neighbors[e]]
                if q >= 0:
                    linked[p, q] = True
        for p in range(size):
            place[later[p]] = -1
        found, gain, nodes = _search(linked, gains[later], best_gain - gains[root], nodes, max_nodes)
        if len(found):
            best = np.empty(len(found) + 1, dtype=np.int64)
            best[0] = root
            best[1:] = later[found]
            best_gain = gain + gains[root]
        if nodes >= max_nodes:
            break
    return best


@kernel
def _smallest_last(starts, neighbors):
    # The vertex of least degree among the remaining first, and the position of each.
    count = len(starts) - 1
    degree = starts[1:] - starts[:-1]
    most = degree.max() if count else 0
    # Buckets by degree (Batagelj and Zaversnik): linear in the number of edges.
    first = np.zeros(most + 2, dtype=np.int64)
    for d in degree:
        first[d + 1] += 1
    first = np.cumsum(first)
    cursor = first[:-1].copy()
    order = np.empty(count, dtype=np.int64)
    position = np.empty(count, dtype=np.int64)
    for v in range(count):
        position[v] = cursor[degree[v]]
        order[position[v]] = v
        cursor[degree[v]] += 1
    left = degree.copy()
    for i in range(count):
        v = order[i]
        for e in range(starts[v], starts[v + 1]):
            w = neighbors[e]
            if left[w] > left[v]:
                swap_at = first[left[w]]
                other = order[swap_at]
                if other != w:
                    order[swap_at], order[position[w]] = w, other
                    position[other], position[w] = position[w], swap_at
                first[left[w]] += 1
                left[w] -= 1
    return order, position


@kernel
def _colored(linked, gains, members, size, order, bound):
    # By colour class, with the maximum gain of a clique among the members up to each.
    left = members[:size].copy()
    num_left = size
    at = 0
    total = 0.0
    chosen = np.empty(size, dtype=np.int64)
    while num_left:
        num_chosen, num_kept, largest = 0, 0, 0.0
        start = at
        for t in range(num_left):
            v = left[t]
            is_free = True
            for k in range(num_chosen):
                if linked[v, chosen[k]]:
                    is_free = False
                    break
            if is_free:
                chosen[num_chosen] = v
                num_chosen += 1
                order[at] = v
                at += 1
                largest = max(largest, gains[v])
            else:
                left[num_kept] = v
                num_kept += 1
        num_left = num_kept
        total += largest
        for t in range(start, at):
            bound[t] = total


@kernel
def _search(linked, gains, best_gain, nodes, max_nodes):
    # The heaviest clique above best_gain (empty if there is none), its gain, and the nodes spent so far.
    count = len(gains)
    order = np.empty((count + 1, count), dtype=np.int64)
    bound = np.empty((count + 1, count))
    at = np.empty(count + 1, dtype=np.int64)
    path = np.empty(count + 1, dtype=np.int64)
    best = np.empty(0, dtype=np.int64)
    members = np.arange(count)
    _colored(linked, gains, members, count, order[0], bound[0])
    at[0] = count - 1
    depth, gain = 0, 0.0
    while depth >= 0:
        t = at[depth]
        if t < 0 or gain + bound[depth, t] <= best_gain or nodes >= max_nodes:
            depth -= 1
            if depth >= 0:
                gain -= gains[path[depth]]
            continue
        at[depth] -= 1
        nodes += 1
        v = order[depth, t]
        path[depth] = v
        size = 0
        for k in range(t):
            if linked[v, order[depth, k]]:
                members[size] = order[depth, k]
                size += 1
        gain += gains[v]
        if gain > best_gain + 1e-12:
            best_gain = gain
            best = path[: depth + 1].copy()
        _colored(linked, gains, members, size, order[depth + 1], bound[depth + 1])
        at[depth + 1] = size - 1
        depth += 1
    return best, best_gain, nodes
