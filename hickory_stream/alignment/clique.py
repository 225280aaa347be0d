"""Exact maximum weight clique in a sparse graph: branch and bound over small neighbourhoods.

Vertices are processed in degeneracy order (the vertex of least degree is removed repeatedly), so that each has few
later neighbours; the bound comes from colouring: a clique has at most one vertex of each colour.
"""

from __future__ import annotations

import numpy as np

from hickory_stream.base.compiled import kernel


@kernel
def heaviest_clique(starts, neighbors, gains, incumbent, max_nodes):
    """Return the vertices of the clique with the greatest total gain, or the best one found in `max_nodes` nodes.

    The graph is in compressed rows, neighbours ascending; `gains` (C,) are positive; `incumbent` is a clique to beat.
    """
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
    """Return the vertices with the one of least degree among the remaining first, and its position of each."""
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
    """Write the members by colour class and, for each, the maximum gain of a clique among the members up to it."""
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
    """Return the heaviest clique above best_gain (empty if there is none), its gain, and the nodes spent so far."""
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
